"""Estimate every row of a record in memory, in both directions.

The numbers come from smoothing/estimate.c.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _smoother
from ..core.arrays import Array
from ..logs.quality.marks import INJECTED, NO_MEASUREMENT, floating_of
from ..logs.scales import Scales
from ..machines import InductionMachine, RotatingMachine
from ..machines.model.flux_map import LinearMap
from .assumptions import NAMES, one_inductance, prior_stds, shows_direction
from .feedback import feedback

#: Outputs of a row, in the order of the C code.
OUTPUTS: tuple[str, ...] = tuple(_smoother.outputs.split())
#: Fields of fo_model and of fo_map, in the order of the C code.
MODEL_FIELDS: tuple[str, ...] = tuple(_smoother.model_fields.split())
MAP_FIELDS: tuple[str, ...] = tuple(_smoother.map_fields.split())
#: Quantities with a budget: angle [rad], speed [rad/s], a component of the flux [Wb], and flux ×
#: current [W s].
QUANTITIES = ("theta_e", "speed_e", "flux", "torque")
#: Names of the shares of a variance: the assumptions, then the smoother, then the noise of
#: the current at the row itself.
SHARES: tuple[str, ...] = (*NAMES, "smoother", "noise")

#: Residual of the relation of a poor drive with all assumptions learnt, as a share of the flux,
#: over an angle of 30°; the log's own residual scales the result (smoothing/learn.c).
MODEL_ERROR = 0.003
#: The part of it that is constant at an operating point and angle: unmodelled harmonics and
#: saturation. A smaller part makes inductances sure and wrong (benchmarks/whole_log.py).
CELL_ERROR = 0.001
#: Share of the inverter's loss that its three parameters do not describe. With 0.05, the measured
#: logs have twice the error (benchmarks/measured.py); simulated inverters would allow it.
INVERTER_ERROR = 0.15
#: Change of the magnet flux and of the resistance, as a share in a second: temperature.
PSI_RATE, RESISTANCE_RATE = 0.01, 0.005
#: Relative error of the estimated variance of the currents' noise.
NOISE_ERROR = 0.05
#: Standard deviation of the drift: share of the rated resistive drop, and of the voltage.
DRIFT_CURRENT, DRIFT_VOLTAGE = 0.02, 0.01


@dataclass(frozen=True, eq=False)
class SmoothingModel:
    """Model and priors of a log.

    Attributes
    ----------
    numbers : dict
        The fields of fo_model (smoothing/model.h), in SI.
    stds : dict
        Prior standard deviation of each assumption.
    map : dict
        The fields of fo_map (firmware/fluxobs_map.h).
    """

    numbers: dict[str, float]
    stds: dict[str, float]
    map: dict[str, Any]

    @classmethod
    def of(
        cls,
        machine: RotatingMachine,
        scales: Scales,
        sample_time: float,
        flux_base: float,
        current_noise: float,
        speed_e: float,
        priors: Mapping[str, float],
    ) -> SmoothingModel:
        """Return the model of a log.

        Parameters
        ----------
        machine : RotatingMachine
        scales : Scales
        sample_time : float
            [s].
        flux_base : float
            Usual flux [Wb].
        current_noise : float
            Standard deviation of a component [A].
        speed_e : float
            Usual electrical speed [rad/s].
        priors : mapping
            See :func:`~fluxobs.smoothing.assumptions.prior_stds`.
        """
        rated = machine.rated_current or scales.current
        cage = isinstance(machine, InductionMachine)
        psi = (machine.magnet_flux or flux_base) if machine.magnets else 0.0
        numbers = {
            "sample_time": sample_time,
            "resistance": machine.R_s,
            "inverter_voltage": machine.inverter_voltage or 0.0,
            "psi": psi,
            "flux_base": flux_base,
            "R_R": machine.R_R if isinstance(machine, InductionMachine) else 0.0,
            "L_M": machine.L_M if isinstance(machine, InductionMachine) else 0.0,
            "current": rated,
            "voltage": scales.voltage,
            "current_noise": current_noise,
            "speed": speed_e,
            "drift_std": max(DRIFT_CURRENT * rated * machine.R_s, DRIFT_VOLTAGE * scales.voltage),
            "one_inductance": float(one_inductance(machine)),
            "model_error": MODEL_ERROR,
            "cell_error": CELL_ERROR,
            "voltage_error": INVERTER_ERROR,
            "psi_rate": PSI_RATE,
            "resistance_rate": RESISTANCE_RATE,
            "rotor_flux_start": 1.0,
            "injection": float(shows_direction(machine)),
        }
        flux_map = machine.map_for(sample_time, flux_base)
        if flux_map is None or (machine.saturation is None and not cage):
            flux_map = LinearMap(psi, *machine.L_dq)
        return cls(numbers, prior_stds(machine, scales, flux_base, priors), flux_map.core())

    def with_numbers(self, **numbers: float) -> SmoothingModel:
        """Return the model with some numbers replaced."""
        return replace(self, numbers=self.numbers | numbers)

    def measures_direction(self, samples: RecordSamples) -> bool:
        """Whether injected rows of these samples measure the direction of the flux."""
        return bool(self.numbers["injection"] > 0 and (samples.marks & INJECTED).any())

    def without_direction(self) -> SmoothingModel:
        """Return the model that does not use injected rows."""
        return self.with_numbers(injection=0.0)

    @property
    def active(self) -> list[str]:
        """Names of the assumptions that are not exact."""
        return [name for name in NAMES if self.stds[name] > 0]

    @property
    def magnets(self) -> bool:
        """Whether the machine has magnets."""
        return self.numbers["psi"] > 0 and self.numbers["L_M"] == 0

    @property
    def rows_per_block(self) -> int:
        """Rows of a block."""
        return int(_smoother.rows_per_block(self.numbers["sample_time"], self.numbers["speed"]))

    def prior(self) -> Assumed:
        """Return the assumptions before the log is seen."""
        stds = np.array([self.stds[name] for name in self.active])
        return Assumed(dict.fromkeys(NAMES, 0.0), np.diag(stds**2), 1.0)


@dataclass(frozen=True, eq=False)
class Assumed:
    """Deviations of the assumptions from the given values, and their covariance.

    Attributes
    ----------
    deviations : dict
        Name → deviation.
    covariance : (n, n) ndarray
        Covariance of the active assumptions.
    filter_scale : float
        Factor on the smoother's covariance, from the innovations.
    """

    deviations: dict[str, float]
    covariance: Array
    filter_scale: float

    def with_deviation(self, name: str, deviation: float) -> Assumed:
        """Return the assumptions with another deviation."""
        return replace(self, deviations=self.deviations | {name: deviation})

    def array(self) -> Array:
        """Return the deviations in the order of the C code."""
        return np.array([self.deviations[name] for name in NAMES])


@dataclass(frozen=True, eq=False)
class RecordSamples:
    """Samples of a record with the angles of an observer.

    Attributes
    ----------
    voltage : (rows, 2) ndarray
        Mean over the interval that ends at the row [V]; NaN if it is unknown.
    current : (rows, 2) ndarray
        [A], finite.
    marks : (rows,) ndarray of int
        See :mod:`fluxobs.logs.quality.marks`.
    angle, angle_std : (rows,) ndarray
        Angle of the observer [rad] and its standard deviation; inf where it is not known.
    """

    voltage: Array
    current: Array
    marks: NDArray[np.int64]
    angle: Array
    angle_std: Array

    @property
    def row_flags(self) -> NDArray[np.int64]:
        """The flags of fo_record (smoothing/rows.h)."""
        measured = self.marks & NO_MEASUREMENT == 0
        return np.asarray(measured + 2 * floating_of(self.marks))


@dataclass(frozen=True)
class Cost:
    """Negative logarithms of a record's likelihood and of the prior, but for constants.

    Attributes
    ----------
    objective : float
        What learning minimises: half the weighted squares of the innovations, less the part of the
        noise, and the prior. A block that was left out counts as one that just fits.
    innovations : float
        The part of the innovations; those that are smaller than the noise cost too, see
        :func:`innovation_cost`.
    prior : float
    correlation : float
        Of neighbouring innovations: correlated ones count as fewer independent ones.
    """

    objective: float
    innovations: float
    prior: float
    correlation: float

    @property
    def sum(self) -> float:
        """Cost of a hypothesis if the innovations are independent."""
        return self.innovations + self.prior


@dataclass(frozen=True, eq=False)
class SmoothedRecord:
    """Estimates of all rows of a record.

    Attributes
    ----------
    model : SmoothingModel
        The model in use.
    assumed : Assumed
        What was learnt, or what was given.
    misfit : float
        Mean square of the normalised innovations: above 0.3 the estimate did not converge, or the
        model is wrong.
    cost : Cost
    settled : bool
        Whether the steps of learning became small.
    left_out : bool
        Whether blocks did not fit and were left out.
    outputs : dict
        Name → (rows,) array, see smoothing/estimate.h.
    known : (rows,) ndarray of bool
        Whether a row is measured, and fits the model.
    marks : (rows,) ndarray of int
        Of the samples in use.
    shares : (blocks, len(QUANTITIES), len(SHARES)) ndarray
        Shares of the variance of each quantity in each block.
    """

    model: SmoothingModel
    assumed: Assumed
    misfit: float
    cost: Cost
    settled: bool
    left_out: bool
    outputs: dict[str, Array]
    known: NDArray[np.bool_]
    marks: NDArray[np.int64]
    shares: Array

    @property
    def converged(self) -> bool:
        """Whether learning settled and every block fits."""
        return self.settled and not self.left_out


def innovation_cost(excess: float, noise: float, blocks: int) -> float:
    """Return the cost of innovations whose squares exceed those of the noise, or fall below them.

    Innovations smaller than the noise of the currents contradict a hypothesis too: a current
    controller returns that noise in its voltages, and a wrong lag may subtract it.

    Parameters
    ----------
    excess : float
        Half the sum of the weighted squares, less what the noise would have.
    noise : float
        Half the sum that the noise would have.
    blocks : int
        Their number.
    """
    if excess >= 0 or noise <= 0:
        return excess
    variance = 2 * (2 * noise) ** 2 / blocks + (NOISE_ERROR * 2 * noise) ** 2
    return 0.5 * (2 * excess) ** 2 / variance


def smooth_record(
    model: SmoothingModel, samples: RecordSamples, start: Assumed, *, learning: bool
) -> SmoothedRecord:
    """Estimate all rows.

    Parameters
    ----------
    model : SmoothingModel
    samples : RecordSamples
        At least two blocks of rows.
    start : Assumed
        Where learning starts; without learning, what is assumed.
    learning : bool
    """
    if not model.measures_direction(samples):
        model = model.without_direction()
    gains, delay = feedback(
        samples.voltage, samples.current, samples.angle, model.numbers["current_noise"]
    )
    given = model.numbers | {
        "feedback_d": -float(gains[0]),
        "feedback_q": -float(gains[1]),
        "feedback_rows": float(delay),
    }
    numbers = np.array([given[name] for name in MODEL_FIELDS], float)
    stds = np.array([model.stds[name] for name in NAMES], float)
    flux_map = np.array([model.map[name] for name in MAP_FIELDS], float)
    table = np.ascontiguousarray(model.map["coefficients"], float)
    deviations, covariance, about, columns, known, shares = _smoother.estimate(
        numbers,
        stds,
        int(model.map["kind"]),
        flux_map,
        table,
        np.ascontiguousarray(samples.voltage, float),
        np.ascontiguousarray(samples.current, float),
        samples.row_flags,
        np.ascontiguousarray(samples.angle, float),
        np.ascontiguousarray(samples.angle_std, float),
        start.array(),
        np.ascontiguousarray(start.covariance, float),
        start.filter_scale,
        learning,
    )
    learnt = Assumed(
        {name: float(value) for name, value in zip(NAMES, deviations, strict=True)},
        np.asarray(covariance),
        float(about[3]),
    )
    outputs = {name: columns[n] for n, name in enumerate(OUTPUTS)}
    beyond = _beyond_the_ends(samples.voltage, model.rows_per_block)
    outputs["doubtful"] = np.where(beyond, 0.0, outputs["doubtful"])  # unknown, not contradictory
    converged = bool(np.isfinite(outputs["theta_e"]).all())
    prior = sum((learnt.deviations[name] / model.stds[name]) ** 2 for name in model.active) / 2
    blocks = len(samples.voltage) // model.rows_per_block
    objective = float(about[2]) if converged else np.inf
    return SmoothedRecord(
        model,
        learnt,
        float(about[0]) if converged else np.inf,
        Cost(
            objective,
            innovation_cost(objective - prior, float(about[5]), blocks),
            prior,
            max(float(about[1]), 0.0),
        ),
        float(about[4]) > 0,
        float(about[6]) > 0,
        outputs,
        (known > 0) & ~beyond,
        samples.marks,
        np.asarray(shares),
    )


def _beyond_the_ends(voltage: Array, block: int) -> NDArray[np.bool_]:
    """Return the rows of blocks at the ends whose voltages the log does not contain.

    No interval ends at the first row; blocks have `block` rows, counted from the first.
    """
    good = np.flatnonzero(np.isfinite(voltage).all(axis=1))
    good = good[good > 0]
    if not len(good):
        return np.zeros(len(voltage), bool)
    first, last = int(good[0]), int(good[-1])
    half = block // 2  # between the middles of two blocks, a row depends on both
    begin = -(-first // block) * block + half if first > 1 else 0
    end = (last + 1) // block * block - half if last + 1 < len(voltage) else len(voltage)
    at = np.arange(len(voltage))
    return np.asarray((at < begin) | (at >= end))


def learn_record(model: SmoothingModel, samples: RecordSamples, start: Assumed) -> SmoothedRecord:
    """Learn, and estimate all rows.

    The flux starts from the parameters at the start. If these are far off, learning may not
    converge or may leave out blocks that fit; it then starts once more, from what it learnt.
    """
    record = smooth_record(model, samples, start, learning=True)
    if record.converged or not np.isfinite(record.cost.objective):
        return record
    again = smooth_record(model, samples, record.assumed, learning=True)
    return again if again.cost.objective < record.cost.objective else record
