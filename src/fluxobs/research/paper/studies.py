"""Further studies of excitation, constants, error bound, scaling with bias, and noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.arrays import Array
from ...observers.levitation_tracker import LevitationTracker
from ...simulation.closed_form.sensors import Sensor, Steps
from ..analysis import (
    balanced_gain,
    bound_on_record,
    certify_observability,
    excitation,
    gradient_excitation,
    observability_gramian,
    peak_gain,
    relation_gradients,
)
from ..analysis.bounds import disturbance
from ..regression import Parametrisation, Regressors
from .converged import converged_run
from .levitation import CORNER, LevitationRecord, filtered, measured
from .section_v import (
    FLUX_RATE,
    LS_SAMPLE_TIME,
    RUN_IN,
    LevitationRun,
    levitation_observer,
    sizes,
    thinned,
)

#: Window of the excitation. Unit s; three periods of the slowest component of the reference.
WINDOW = 2.0


@dataclass(frozen=True)
class Excited:
    """Eigenvalue ratios (smallest over largest, per-unit) over :data:`WINDOW` before the jump.

    Attributes
    ----------
    gradient : float
        Ratio for the gradient n of the relation, the condition on signals for (pe1).
    certificate : float
        Smallest per-unit eigenvalue of the condition on signals for flux and drift.
    flux : float
        Ratio for Φ_λ (pe1).
    all_constants : float
        Ratio for Ψ with unknowns (λ, θ, δ_i, θᵀQ1θ) (pe2).
    observability : float
        Ratio for the observability Gramian, in which the drift moves the flux.
    weakest : dict
        Per-unit shares of flux, drift and current bias in the Gramian's least visible direction.
    """

    gradient: float
    certificate: float
    flux: float
    all_constants: float
    observability: float
    weakest: dict[str, float]


def _nominal(run: LevitationRun) -> tuple[Regressors, int, int]:
    skip = round(RUN_IN / CORNER / run.record.h) + round(1.0 / run.record.h)
    jump = int(np.searchsorted(run.record.t, run.record.jump))
    return run.rows.part(slice(skip, jump)), skip, jump


def excited(run: LevitationRun) -> Excited:
    """Compute the excitation of a scenario."""
    rows, skip, jump = _nominal(run)
    h, size = run.record.h, sizes(run.record)[1]
    flux_rows, current_rows = run.record.flux[skip:jump:5], run.record.true_current[skip:jump:5]
    relations = [run.record.constraint]
    n, _ = relation_gradients(relations, flux_rows, current_rows)
    constants = Parametrisation(run.record.constraint, "structured", CORNER)
    psi = np.asarray(constants.psi_record(rows))
    thin = slice(None, None, 5)
    flux = excitation(np.asarray(rows.Phi_flux)[thin], 5 * h, WINDOW)
    # Scale each column to unit rms, so that the ratio shows only how similar the columns are.
    full = excitation((psi / np.sqrt(np.mean(psi**2, axis=0)))[thin], 5 * h, WINDOW)
    gramian = observability_gramian(rows, constants, h, WINDOW, size)
    scale = 1 / np.sqrt(np.diag(gramian))
    values, vectors = np.linalg.eigh(scale[:, None] * gramian * scale)
    # Convert to per-unit unknowns to get their shares in the direction seen least.
    weakest = np.abs(scale * vectors[:, 0])
    weakest /= np.linalg.norm(weakest)
    blocks = {"flux": slice(0, 2), "drift": slice(2, 4), "current bias": slice(4, 6)}
    certificate = certify_observability(relations, flux_rows, current_rows, 5 * h, WINDOW)
    return Excited(
        gradient_excitation(n, 5 * h, WINDOW).ratio,
        float(certificate.smallest.min()),
        flux.ratio,
        full.ratio,
        float(max(values[0], 0) / values[-1]),
        {name: float(np.linalg.norm(weakest[block])) for name, block in blocks.items()},
    )


@dataclass(frozen=True)
class ConstantEstimate:
    """Least-squares estimate of one constant over the last fifth of a span.

    Attributes
    ----------
    true, estimate, std : (float, float)
        True value and estimate at the end; median standard deviation; [V] or [A].
    known : float
        Share of samples that the observer reports as valid: `valid`, or `current_bias_valid` for
        the current bias.
    """

    true: tuple[float, float]
    estimate: tuple[float, float]
    std: tuple[float, float]
    known: float


def parameters(run: LevitationRun) -> dict[str, dict[str, ConstantEstimate]]:
    """Return drift and current bias at the end of the spans "before" and "after" the jump."""
    record, estimates = run.record, run.least_squares
    rows, _ = thinned(record, LS_SAMPLE_TIME)
    last = int(np.searchsorted(record.t[rows], record.jump - LS_SAMPLE_TIME / 2)) - 1

    def pair(values: Array, row: int) -> tuple[float, float]:
        return float(values[row, 0]), float(values[row, 1])

    constants = {}
    for name, first, row in (("before", 0, last), ("after", last + 1, len(rows) - 1)):
        late = slice(row - (row - first) // 5, row + 1)
        constants[name] = {
            "drift": ConstantEstimate(
                pair(record.drift[rows], row),
                pair(estimates.drift, row),
                pair(np.median(estimates.drift_std[late], axis=0)[None], 0),
                float(estimates.valid[late].mean()),
            ),
            "current bias": ConstantEstimate(
                pair(record.current_bias[rows], row),
                pair(estimates.current_bias, row),
                pair(np.median(estimates.current_bias_std[late], axis=0)[None], 0),
                float(estimates.current_bias_valid[late].mean()),
            ),
        }
    return constants


@dataclass(frozen=True)
class Robust:
    """Proposition 1 with the balanced gain on one scenario.

    Attributes
    ----------
    rms : dict
        Bias factor → relative rms flux error in the second half of the time before the jump.
    bound, tight, largest : float
        Corrected bound, the least bound for disturbances of this size along the trajectory, and
        largest error in steady state, as relative values.
    """

    rms: dict[float, float]
    bound: float
    tight: float
    largest: float


def robust(run: LevitationRun) -> Robust:
    """Scale the biases and compare the corrected bound with the error."""
    base = run.record
    nominal, skip, jump = _nominal(run)
    Gamma = balanced_gain(np.asarray(nominal.Phi_flux), FLUX_RATE)
    size = sizes(base)[0]
    late = slice((skip + jump) // 2, jump)
    rms, largest = {}, 0.0
    for factor in (0.5, 1.0, 2.0):
        changed = measured(base.scenario, base.machine, base.trajectory, base.jump, factor)
        regression, _ = filtered(changed)
        result = converged_run(changed, regression, Gamma, None, skip)
        error = np.linalg.norm(result.error, axis=1)[late] / size
        rms[factor] = float(np.sqrt(np.mean(error**2)))
        if factor == 1.0:
            largest = float(error.max())
    constants = Parametrisation(base.constraint, "structured", CORNER)
    thin = nominal.part(slice(None, None, 5))
    drift, bias = base.drift[0], base.current_bias[0]
    bound = bound_on_record(thin, constants, Gamma, 5 * base.h, WINDOW, 0.0, drift, bias, t=np.inf)
    b = np.linalg.norm(disturbance(thin, constants, Gamma, drift, bias), axis=1).max()
    period = round(base.scenario.period / (5 * base.h))
    rows = len(thin.y)
    lags = min(2 * period, rows // 2)
    ends = np.arange(rows - min(period, rows - lags - 1), rows, max(1, period // 256))
    gain = peak_gain(thin.Phi_flux, Gamma, 5 * base.h, ends, lags)
    return Robust(rms, float(bound / size), float(gain * b / size), largest)


@dataclass(frozen=True)
class Noisy:
    """Result of the least squares under sensor noise.

    Attributes
    ----------
    error, claimed : float
        Relative rms flux error after 2 s: true error, and error stated by the covariance.
    noise_share : float
        Median over time of the noise share of the larger flux component.
    valid : float
        Share of samples that the observer reports as valid.
    """

    error: float
    claimed: float
    noise_share: float
    valid: float


#: White noise of the sensors at 1 kHz [A], [V], and the steps of their converters.
CURRENT_NOISE, VOLTAGE_NOISE = 1e-3, 1e-2
CURRENT_STEP, VOLTAGE_STEP = 5e-4, 5e-3


def noise_std() -> tuple[float, float]:
    """Return the standard deviations of a current [A] and a voltage [V], converter steps included.

    A step q has the variance q²/12.
    """
    return (
        float(np.hypot(CURRENT_NOISE, CURRENT_STEP / np.sqrt(12))),
        float(np.hypot(VOLTAGE_NOISE, VOLTAGE_STEP / np.sqrt(12))),
    )


def with_noise(record: LevitationRecord, seed: int = 1) -> tuple[Array, Array]:
    """Return (currents, volt-seconds) with sensor noise and converter steps."""
    machine, h = record.machine, record.h
    none = Steps(np.zeros((1, 2)))
    current_sensor = Sensor(none, noise=CURRENT_NOISE, quantum=CURRENT_STEP)
    voltage_sensor = Sensor(none, noise=VOLTAGE_NOISE, quantum=VOLTAGE_STEP)
    current = current_sensor.measure(record.t, record.current, seed=seed)
    voltage = record.trajectory.voltage
    error_i = current - record.current
    error_u = voltage_sensor.measure(record.t, voltage, seed=seed + 1) - voltage
    mean_i = (error_i + np.roll(error_i, 1, axis=0)) / 2
    v = record.volt_seconds + h * (error_u @ machine.B.T - mean_i @ machine.R.T)
    v[0] = 0.0
    return current, v


def noisy(record: LevitationRecord, duration: float, memory: float) -> Noisy:
    """Run the least squares on the noisy record. `duration` and `memory` are in seconds."""
    rows = slice(0, round(duration / record.h) + 1)
    t = record.t[rows]
    current, v = with_noise(record)
    current, v = current[rows], v[rows]
    observer = levitation_observer(record.machine, record.h, memory, (CURRENT_NOISE, VOLTAGE_NOISE))
    estimates = observer.run(current=current, volt_seconds=v)
    late = t >= 2.0
    size = sizes(record)[0]
    error = np.linalg.norm(estimates.flux - record.flux[rows], axis=1)[late] / size
    claimed = np.linalg.norm(estimates.flux_std, axis=1)[late] / size
    return Noisy(
        float(np.sqrt(np.mean(error**2))),
        float(np.sqrt(np.mean(claimed**2))),
        float(np.median(estimates.noise_share[late].max(axis=1))),
        float(estimates.valid[late].mean()),
    )


def mechanics(run: LevitationRun) -> tuple[float, float]:
    """Return rms errors of position [m] and velocity [m/s] from the least squares' flux.

    The errors are those between the first second and the jump.
    """
    base, estimate = run.record, run.least_squares
    rows, _ = thinned(base, LS_SAMPLE_TIME)
    tracker = LevitationTracker(base.machine, LS_SAMPLE_TIME)
    position, velocity = tracker.run(estimate.flux, base.current[rows] - estimate.current_bias)
    late = (base.t[rows] > 1.0) & (base.t[rows] < base.jump)
    truth = base.trajectory
    return (
        float(np.sqrt(np.mean((position - truth.position[rows, 0])[late] ** 2))),
        float(np.sqrt(np.mean((velocity - truth.velocity[rows, 0])[late] ** 2))),
    )
