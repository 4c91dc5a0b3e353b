"""Every row of a log from the posterior of the whole log; the forward run is its witness.

Rows that the posterior does not explain keep the estimate of the forward run. No command uses this
yet.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checking.findings import Check
from ..checking.search import check_log
from ..core.arrays import Array
from ..errors import FluxobsError
from ..inference.items import UNEQUAL_PHASES, shares_by_item
from ..inference.machine_file import DELAY_STD, LAG_STD, machine_file
from ..inference.posterior import INDEX, QUANTITIES, Posterior, posterior_of
from ..logs.time.aligned import Aligned
from ..machines import InductionMachine, RotatingMachine
from ..machines.model.frames import wrap
from ..observers import AdaptiveObserver
from ..observers.adaptive import Learnt
from ..observers.for_log import Prepared
from ..smoothing.assumptions import Calibration, with_scale
from ..smoothing.estimate import SmoothedEstimate, trusted
from .budget import CALIBRATION, NAMES, Budget
from .columns import EstimateRows, rows_of
from .hints import Hints, hints_of
from .lag import UNUSUAL_COST, UNUSUAL_LAGS, LagDecision, shifted
from .statistics import THIN_ROWS, Statistics

#: Lag of the posterior beyond which the log is read with the nearest one instead [samples].
NEXT_LAG = 0.5


class PosteriorLog:
    """The estimate of a log that is in memory.

    Parameters
    ----------
    run : Prepared
        The observer that gives hints.
    priors : mapping
        Standard deviations that somebody states.
    count : callable
        Called with the number of rows that a step has processed.
    shifts : tuple of int
        Possible errors of the log's lag [samples].
    """

    def __init__(
        self,
        run: Prepared,
        priors: Mapping[str, float],
        count: Callable[[int], Any],
        shifts: tuple[int, ...] = (0,),
    ) -> None:
        assert isinstance(run.machine, RotatingMachine)
        self.run, self.priors, self.count, self.shifts = run, priors, count, shifts
        self.machine: RotatingMachine = run.machine
        self.calibration = Calibration.of(priors)
        self.budget = Budget.for_machine(self.machine, priors)
        self.posterior: Posterior | None = None
        self.shift = 0
        self.weights: dict[int, float] = {}
        self.state: Any = None
        self.learnt: Learnt | None = None
        self.checked: Check | None = None

    def rows(self) -> Iterator[EstimateRows]:
        """Yield the estimates of all rows."""
        hints = hints_of(self.run)
        self.count(len(hints.angle))
        self.state, self.learnt = hints.first.state, hints.learnt
        self._infer(hints)
        self._examine()
        yield self._rows(hints)

    @property
    def flux_base(self) -> float:
        """Usual flux [Wb]."""
        observer: Any = self.run.observer
        plain = observer.plain if isinstance(observer, AdaptiveObserver) else observer
        return float(plain.flux_base)

    def _infer(self, hints: Hints) -> None:
        """Find the posterior, and the lag if nobody states it.

        The posterior of a log finds a lag of a sample or less itself; a log that is read with
        another one may have none.
        """
        for shift in self.shifts:
            self.posterior, self.shift = self._posterior(hints, shift), shift
            if self.posterior is not None:
                break
        if self.posterior is None or len(self.shifts) < 2:
            return
        late, std = late_of(self.posterior)
        self.weights = lag_weights(self.shift - late, std, self.shifts)
        best = max(self.weights, key=lambda shift: self.weights[shift])
        if best == self.shift or abs(late) < NEXT_LAG:
            return
        other = self._posterior(hints, best)
        if other is not None:
            self.posterior, self.shift = other, best

    def _posterior(self, hints: Hints, shift: int) -> Posterior | None:
        samples, rows = hints.first.samples, len(hints.angle)
        voltage, current = engine_samples(samples, shift)
        file = machine_file(
            self.machine,
            self.run.scales,
            self.run.log.sample_time,
            self.flux_base,
            self.priors,
        )
        return posterior_of(
            file,
            voltage,
            current,
            self.run.log.sample_time,
            hints.angle,
            hints.sure,
            stride=max(1, rows // THIN_ROWS),
        )

    def _examine(self) -> None:
        """Check the log: with exchanged or turned vectors, an estimate may fit and be wrong."""
        try:
            log = self.run.log.lagged(self.shift)
            self.checked = check_log(log, self.machine, scales=self.run.scales)
        except FluxobsError:  # too many gaps
            self.checked = None

    def _rows(self, hints: Hints) -> EstimateRows:
        """Return the estimates of all rows, and fill the budget."""
        samples, posterior = hints.first.samples, self.posterior
        witness = self._witness(hints)
        rearranged = self.checked is not None and self.checked.rearranged
        if rearranged:
            estimate, known = replace(witness, valid=np.zeros_like(witness.valid)), None
        elif posterior is None:
            self.budget.misfit = float("inf")
            estimate, known = witness, None
        else:
            self.budget.misfit = 0.0
            estimate, known = self._estimate(posterior, witness, samples)
            self._add_budget(posterior, estimate, known, samples)
        doubtful = np.zeros(len(samples.t), bool) if known is None else ~known & ~estimate.valid
        self.budget.add_stretches(samples.t, doubtful)
        rows = rows_of(self.run.log, self.machine, self.run.observer, samples, estimate)
        rows.more["unexplained"] = doubtful.astype(float)
        return rows

    def _witness(self, hints: Hints) -> SmoothedEstimate:
        """Return the estimates of the forward run."""
        own, machine = hints.first.estimate, self.machine
        n, samples = len(hints.angle), hints.first.samples
        unknown = np.full(n, np.nan)
        current = np.where(np.isfinite(samples.current), samples.current, 0.0)
        torque = own.flux[:, 0] * current[:, 1] - own.flux[:, 1] * current[:, 0]

        def column(name: str, usual: Array) -> Array:
            return np.asarray(getattr(own, name, usual))

        return SmoothedEstimate(
            flux=own.flux,
            flux_std=np.full((n, 2), np.nan),
            psi_f=own.psi_f,
            psi_f_std=column("psi_f_std", unknown),
            theta_e=own.theta_e,
            theta_e_std=own.theta_e_std,
            speed_e=own.speed_e,
            speed_e_std=unknown,
            drift=own.drift,
            drift_std=column("drift_std", unknown),
            resistance=column("resistance", np.full(n, machine.R_s)),
            resistance_std=column("resistance_std", unknown),
            inverter_voltage=column("inverter_voltage", np.full(n, machine.inverter_voltage or 0)),
            inverter_voltage_std=column("inverter_voltage_std", unknown),
            torque=torque,
            torque_std=unknown,
            innovation=own.innovation,
            valid=hints.first.known,
        )

    def _estimate(
        self, posterior: Posterior, witness: SmoothedEstimate, samples: Aligned
    ) -> tuple[SmoothedEstimate, NDArray[np.bool_]]:
        """Return the estimates of the posterior, of the witness elsewhere, and where which is."""
        row, scale = posterior.rows, self.calibration
        known = np.isfinite(row["angle"])
        n = len(known)
        flux = np.stack([row["flux_alpha"], row["flux_beta"]], axis=1)
        flux_std = np.stack([row["flux_alpha_std"], row["flux_beta_std"]], axis=1)
        psi, psi_std = row["psi"], row["psi_std"]
        speed, speed_std = row["speed"], row["speed_std"]
        if isinstance(self.machine, InductionMachine):
            current = np.where(np.isfinite(samples.current), samples.current, 0.0)
            slip = np.where(known, self.machine.slip(flux, current), 0.0)
            speed = speed + slip
            speed_std = np.hypot(speed_std, self._slip_share(posterior) * slip)
        elif not self.machine.magnets:
            psi = self.machine.position(flux, samples.current)[1]
            psi_std = flux_std.max(axis=1)
        heat = posterior.value("heat") * np.arange(n) / n
        resistance = np.exp(posterior.value("resistance")) * (1 + heat)
        own_std = posterior.std("resistance") * resistance
        loss, loss_std = loss_of(posterior)
        estimate = SmoothedEstimate(
            flux=flux,
            flux_std=np.asarray(with_scale(flux_std, flux, scale.voltage)),
            psi_f=psi,
            psi_f_std=np.asarray(with_scale(psi_std, psi, scale.voltage)),
            theta_e=np.asarray(wrap(row["angle"])),
            theta_e_std=row["angle_std"],
            speed_e=speed,
            speed_e_std=speed_std,
            # What the flux needs besides the log's voltages; the engine has their error.
            drift=-np.stack([row["drift_alpha"], row["drift_beta"]], axis=1),
            drift_std=np.hypot(row["drift_alpha_std"], row["drift_beta_std"]) / np.sqrt(2),
            resistance=resistance,
            resistance_std=np.asarray(with_scale(own_std, resistance, scale.ratio)),
            inverter_voltage=np.full(n, loss),
            inverter_voltage_std=np.full(n, loss_std),
            torque=row["torque"],
            torque_std=np.asarray(with_scale(row["torque_std"], row["torque"], scale.ratio)),
            innovation=row["innovation"],
            valid=known & trusted(row["angle"], row["angle_std"], ~known),
        )
        mixed = {
            name: _either(known, getattr(estimate, name), getattr(witness, name))
            for name in SmoothedEstimate.__dataclass_fields__
        }
        return SmoothedEstimate(**mixed), known

    def _slip_share(self, posterior: Posterior) -> float:
        return float(np.hypot(posterior.std("rotor_resistance"), self.calibration.ratio))

    def _add_budget(
        self,
        posterior: Posterior,
        estimate: SmoothedEstimate,
        known: NDArray[np.bool_],
        samples: Aligned,
    ) -> None:
        stride, count = posterior.stride, len(known)
        items = shares_by_item(posterior.shares, NAMES, bool(self.budget.inductance))
        scale = self.calibration
        flux, torque = estimate.flux[::stride], estimate.torque[::stride]
        items[:, QUANTITIES.index("flux"), CALIBRATION] = (
            scale.voltage**2 * (flux**2).sum(axis=1) / 2
        )
        items[:, QUANTITIES.index("torque"), CALIBRATION] = (scale.ratio * torque) ** 2
        valid = np.add.reduceat((known & estimate.valid).astype(float), np.arange(0, count, stride))
        valid = np.where(known[::stride], valid, 0.0)
        self.budget.add_items(samples.t[::stride], items, valid)

    def lag(self) -> LagDecision | None:
        """Return the lag that was learnt; None if it was given."""
        if len(self.weights) < 2:
            return None
        lag = self.run.log.layout.lag
        weights = {lag + shift: weight for shift, weight in self.weights.items()}
        return LagDecision(lag + self.shift, weights, self._difference())

    def _difference(self) -> float:
        """Return by how much the position changes with the lag [rad/sample], rms."""
        if self.posterior is None or not self.budget.rows:
            return float("nan")
        std = self.budget.of("theta_e")[NAMES.index("lag")]
        return float(std / max(late_of(self.posterior)[1], 1e-9))

    def fractional_lag(self) -> tuple[float, float] | None:
        """Return the lag of the voltages behind the currents and its std [samples]; None: unknown.

        A delay of the currents is part of it: only the difference changes the relation.
        """
        if self.posterior is None:
            return None
        late, std = late_of(self.posterior)
        return self.run.log.layout.lag + self.shift - late, std

    def parameters(self, statistics: Statistics) -> Learnt | None:
        """Return the learnt parameters, with resistance and magnet flux averaged over the run."""
        posterior = self.posterior
        if posterior is None:
            return self.learnt
        machine, scale = self.machine, self.calibration
        valid = statistics.valid > 0

        def of(name: str, ratio: float) -> tuple[float, float]:
            value = float(np.exp(posterior.value(name)))
            return value, float(with_scale(value * posterior.std(name), value, ratio))

        psi = of("psi_f", scale.voltage) if machine.magnets else (self.flux_base, float("nan"))
        if valid:
            psi = statistics.mean("psi_f"), statistics.mean("psi_f_std")
        resistance = of("resistance", scale.ratio)
        if valid:
            resistance = statistics.mean("resistance"), statistics.mean("resistance_std")
        loss, loss_std = loss_of(posterior)
        names = ("offset_alpha", "offset_beta")
        unequal = tuple(f"harmonic_{UNEQUAL_PHASES}_{part}" for part in "dq")
        (d, d_std), (q, q_std) = (of(f"L_{axis}", scale.ratio) for axis in "dq")
        given = (1.0, 1.0) if machine.saturation is not None else machine.L_dq
        single = len(machine.inductance_names) == 1
        return Learnt(
            psi_f=psi[0],
            psi_f_std=psi[1],
            resistance=resistance[0],
            resistance_std=resistance[1],
            inverter_voltage=loss,
            inverter_std=loss_std,
            offset=(posterior.value(names[0]), posterior.value(names[1])),
            offset_std=(posterior.std(names[0]), posterior.std(names[1])),
            asymmetry=(
                posterior.value(unequal[0]) / self.flux_base,
                posterior.value(unequal[1]) / self.flux_base,
            ),
            asymmetry_std=(
                posterior.std(unequal[0]) / self.flux_base,
                posterior.std(unequal[1]) / self.flux_base,
            ),
            inductance_error=(d / given[0] - 1, 0.0 if single else q / given[1] - 1),
            inductance_std=(d_std / given[0], 0.0 if single else q_std / given[1]),
        )


def _either(known: NDArray[np.bool_], own: Any, other: Any) -> Any:
    """Return a column where it is known, and the other one elsewhere."""
    return np.where(known if np.ndim(own) == 1 else known[:, None], own, other)


def engine_samples(samples: Aligned, shift: int) -> tuple[Array, Array]:
    """Return voltages from each row to the next, and currents, NaN where they are missing.

    A row that repeats the one before it bit by bit, zeros included, is missing: the logger wrote it
    twice, or the drive was off.
    """
    voltage = shifted(samples.voltage, shift)
    onward = np.concatenate([voltage[1:], np.full((1, 2), np.nan)])
    current = samples.current
    same = np.zeros(len(current), bool)
    same[1:] = (np.diff(current, axis=0) == 0).all(axis=1) & (np.diff(onward, axis=0) == 0).all(
        axis=1
    )
    repeated = same[:, None]
    return np.where(repeated, np.nan, onward), np.where(repeated, np.nan, current)


def late_of(posterior: Posterior) -> tuple[float, float]:
    """Return by how much the voltages act later than the log says, after the currents, and its
    standard deviation [samples]."""
    names = ("lag", "delay")
    at = [INDEX[name] for name in names]
    variance = float(posterior.covariance[np.ix_(at, at)].sum())
    return sum(posterior.value(name) for name in names), float(np.sqrt(max(variance, 0.0)))


def lag_weights(lag: float, std: float, shifts: tuple[int, ...]) -> dict[int, float]:
    """Return the probability of each lag, from that of the posterior [samples]."""
    variance = std**2 + LAG_STD**2 + DELAY_STD**2
    costs = {
        shift: 0.5 * (lag - shift) ** 2 / variance
        + (UNUSUAL_COST if shift in UNUSUAL_LAGS else 0.0)
        for shift in shifts
    }
    least = min(costs.values())
    weights = {shift: float(np.exp(least - cost)) for shift, cost in costs.items()}
    total = sum(weights.values())
    return {shift: weight / total for shift, weight in weights.items()}


def loss_of(posterior: Posterior) -> tuple[float, float]:
    """Return the inverter's loss of a phase and its standard deviation [V]."""
    loss = float(np.exp(posterior.value("loss")))
    return loss, loss * posterior.std("loss")
