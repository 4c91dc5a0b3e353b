"""Run every observer on the same record and return relative errors over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ...core.arrays import Array
from ...machines import MagLev2DOF
from ...machines.model.immersion import Immersion
from ...observers import LeastSquaresObserver
from ...observers.immersed import ImmersionEstimate, ImmersionObserver
from ..analysis import balanced_basis, balanced_gain, balanced_repaired, observability_gramian
from ..regression import Parametrisation, Regressors
from ..regression.laws import (
    PEBO,
    DremObserver,
    FluxObserver,
    PrintedAdaptiveObserver,
    RiccatiObserver,
    RobustObserver,
    VoltageModel,
    run,
)
from .converged import converged_run
from .levitation import (
    ADAPTIVE_GAIN,
    CORNER,
    ROBUST_GAIN,
    FilteredRecord,
    LevitationRecord,
    filtered,
)
from .pmsm import SERVO_CORNER, MotorRecord

#: Time from which the regression is used. Unit 1/ν; the filters' transient is then e^{-15}. The
#: paper has no run-in: FROM_THE_START is its law from the first sample on.
RUN_IN = 15.0
FROM_THE_START = "adaptive, printed gain, no run-in"
#: Rates of the balanced gains on the levitation [1/s].
FLUX_RATE, CONSTANTS_RATE = 8.0, 2.0
#: Window in which the basis of DREM is balanced [s].
WINDOW = 3.0
#: Noise assumed on records without noise, relative to the size of the regression.
NUMERICAL = 1e-6
#: Sample time and memory of the least squares on the levitation [s]. Volt-seconds are exact over
#: intervals of any length.
LS_SAMPLE_TIME, LS_MEMORY = 1e-2, 0.1


@dataclass(frozen=True, eq=False)
class ErrorCourse:
    """Errors of an observer over time.

    Attributes
    ----------
    t : (rows,) ndarray
        Time [s].
    flux : (rows,) ndarray
        |λ̂ - λ| over the largest |λ|.
    constants : (rows,) ndarray or None
        |θ̂ - θ| over |θ|, per-unit; None if the observer estimates no constants.
    parameters : (rows,) ndarray or None
        |θ̂_m - θ_m| [V]. The paper's Figure 3 sums volts, webers and their products; only the drift
        is visible in the sum.
    change : float or None
        Largest change at the last halving of the steps, over the largest error; None for an
        observer that works on samples.
    """

    t: Array
    flux: Array
    constants: Array | None = None
    parameters: Array | None = None
    change: float | None = None

    def at(self, time: float) -> float:
        """Return the flux error at the first row at or after `time`; inf if it is not finite."""
        value = float(self.flux[min(int(np.searchsorted(self.t, time - 1e-9)), len(self.t) - 1)])
        return value if np.isfinite(value) else float("inf")

    def first_below(self, level: float, since: float) -> float:
        """Return the delay after `since` from which the error stays below `level`; inf if never.

        Only half a record after `since` counts: until the next jump or the end.
        """
        inside = (self.t >= since) & (self.t <= since + self.t[-1] / 2 - 1e-9)
        late = np.flatnonzero(~(self.flux[inside] < level))
        times = self.t[inside]
        if len(late) == 0:
            return 0.0
        return float("inf") if late[-1] == len(times) - 1 else float(times[late[-1] + 1] - since)


def rms(t: Array, error: Array, start: float, stop: float) -> float:
    """Return the rms of an error between two times."""
    inside = (t >= start) & (t <= stop)
    return float(np.sqrt(np.mean(error[inside] ** 2)))


@dataclass(frozen=True, eq=False)
class LevitationRun:
    """A record, its regression, and the error courses of all observers, with their names."""

    record: LevitationRecord
    rows: Regressors
    courses: dict[str, ErrorCourse]
    least_squares: ImmersionEstimate


def sizes(record: LevitationRecord) -> tuple[float, Array]:
    """Return (size of the flux, sizes of (λ, θ, δ_i, 2/ν θᵀQ1θ))."""
    flux = float(np.linalg.norm(record.flux, axis=1).max())
    drift, bias = np.abs(record.drift).max(), np.abs(record.current_bias).max()
    last = 2 / CORNER * record.machine.g * drift**2
    return flux, np.r_[flux, flux, drift, drift, bias, bias, last]


def _true_constants(record: LevitationRecord, constants: Parametrisation) -> Array:
    """Return the constants (rows, n_θ), with one value before the jump and one after the jump."""
    before, after = (
        np.asarray(constants.constants(record.drift[k], record.current_bias[k])) for k in (0, -1)
    )
    return np.where((record.t > record.jump)[:, None], after, before)


def _course(
    record: LevitationRecord,
    flux_error: Array,
    error: Array | None = None,
    true: Array | None = None,
    change: float | None = None,
) -> ErrorCourse:
    """Return the error course of the flux (rows, n) and the constants (rows, n_θ)."""
    flux = np.linalg.norm(flux_error, axis=1) / sizes(record)[0]
    if error is None or true is None:
        return ErrorCourse(record.t, flux, change=change)
    # Relative errors of θ and of the block from the current bias, without the last constant.
    blocks = [slice(0, 2), slice(2, 4)]
    relative = [
        np.linalg.norm(error[:, block], axis=1) / np.linalg.norm(true[:, block], axis=1).max()
        for block in blocks
    ]
    return ErrorCourse(
        record.t, flux, np.hypot(*relative), np.linalg.norm(error[:, :2], axis=1), change
    )


def levitation_run(record: LevitationRecord, all_observers: bool = True) -> LevitationRun:
    """Run the paper's observers (printed, corrected, repaired) and the least squares."""
    regression, printed_regression = filtered(record)
    rows = regression.rows
    h, v = record.h, jnp.asarray(record.volt_seconds)
    skip = round(RUN_IN / CORNER / h)
    printed = Parametrisation(record.constraint, "printed", CORNER)
    structured = Parametrisation(record.constraint, "structured", CORNER)
    jump = int(np.searchsorted(record.t, record.jump))
    # Gains come from the excitation before the jump; gains from a design run would also work.
    nominal = rows.part(slice(skip, jump))
    Gamma = balanced_gain(np.asarray(nominal.Phi_flux), FLUX_RATE)

    def sampled(observer: FluxObserver, constants: Parametrisation | None = None) -> ErrorCourse:
        flux, estimates = run(observer, h, v, rows, skip)
        true = None if constants is None else _true_constants(record, constants)
        error = None if true is None else np.asarray(estimates) - true
        return _course(record, np.asarray(flux) - record.flux, error, true)

    def robust(gain: Any, used: FilteredRecord = regression) -> ErrorCourse:
        result = converged_run(record, used, gain, None, skip)
        return _course(record, result.error, change=result.change)

    def adaptive(factor: float, used: FilteredRecord = regression, skip: int = skip) -> ErrorCourse:
        result = converged_run(record, used, factor * np.array(ADAPTIVE_GAIN), printed, skip)
        true = _true_constants(record, printed)
        return _course(record, result.error[:, :2], result.error[:, 2:], true, result.change)

    courses = {
        "robust, printed gain": robust(ROBUST_GAIN),
        "robust, balanced gain": robust(Gamma),
        "robust, balanced gain, printed Φ": robust(Gamma, printed_regression),
        "adaptive, printed gain": adaptive(1.0),
        "adaptive, printed gain and Φ": adaptive(1.0, printed_regression),
        "adaptive, ten times the gain": adaptive(10.0),
        "adaptive, repaired": sampled(
            balanced_repaired(nominal, structured, h, FLUX_RATE, CONSTANTS_RATE, round(2.0 / h)),
            structured,
        ),
        "voltage model": sampled(VoltageModel(2)),
        "PEBO, least squares": sampled(PEBO(2, "least-squares", Gamma)),
    }
    if all_observers:
        courses[FROM_THE_START] = adaptive(1.0, skip=0)
        size = sizes(record)[1]
        noise = NUMERICAL * regression_size(nominal, size)
        courses["Riccati, memory 1 s"] = sampled(
            RiccatiObserver(1.0, size, noise, structured), structured
        )
        basis = mixing_basis(nominal, structured, h, size)
        courses["DREM, finite time"] = sampled(
            DremObserver(1.0, 1.0, basis, structured), structured
        )
    estimate = least_squares(record)
    courses["least squares"] = _least_squares_course(record, estimate)
    return LevitationRun(record, rows, courses, estimate)


def regression_size(nominal: Regressors, size: Array) -> float:
    """Return the size of the regression's y that a flux of this size causes."""
    return float(np.sqrt(np.mean(np.square(nominal.Phi_flux)))) * float(size[0])


def mixing_basis(nominal: Regressors, constants: Parametrisation, h: float, size: Array) -> Array:
    """Return the basis of the unknowns for DREM, balanced by the excitation in :data:`WINDOW`."""
    gramian = observability_gramian(nominal, constants, h, WINDOW, size)
    return np.asarray(size[:, None] * balanced_basis(gramian, WINDOW))


def thinned(record: LevitationRecord, sample_time: float) -> tuple[NDArray[np.int_], Array]:
    """Return (row numbers, volt-seconds summed between these rows)."""
    step = round(sample_time / record.h)
    rows = np.arange(0, len(record.t), step)
    sums = np.cumsum(record.volt_seconds, axis=0)[rows]
    return rows, np.diff(sums, axis=0, prepend=sums[:1])


def levitation_observer(
    machine: MagLev2DOF,
    h: float,
    memory: float,
    noise: tuple[float, float] = (0.0, 0.0),
    bias_current: float = 0.5,
    drift_prior: float = 2e-5,
    current_bias_prior: float = 5e-3,
) -> ImmersionObserver:
    """Return a least-squares observer for drift and current bias on a pair of coils.

    `noise` contains the standard deviations of a current [A] and of a mean voltage [V] per sample;
    `bias_current` [A] determines the size of the flux.
    """
    size = machine.k_2 * bias_current / machine.g
    current_noise, voltage_noise = noise
    # Voltage noise accumulates in w over the memory, in addition to the current noise.
    walk = 2 * machine.g * size * voltage_noise / machine.N * np.sqrt(h * memory)
    sensed = float(np.hypot(machine.constraint_noise(size, current_noise), walk))
    return ImmersionObserver(
        Immersion((machine.constraint,), ("drift", "current-bias")),
        machine.R,
        machine.B,
        h,
        memory,
        flux_base=np.full(2, size),
        constraint_noise=np.array([max(1e-6 * machine.g * size**2, sensed)]),
        drift_prior=np.full(2, drift_prior),
        current_bias_prior=np.full(2, current_bias_prior),
        current_noise=current_noise or None,
        voltage_noise=voltage_noise,
    )


def least_squares(record: LevitationRecord) -> ImmersionEstimate:
    """Run the least squares with drift and current bias unknown, without noise."""
    observer = levitation_observer(record.machine, LS_SAMPLE_TIME, LS_MEMORY, drift_prior=1e-5)
    rows, v = thinned(record, LS_SAMPLE_TIME)
    return observer.run(current=record.current[rows], volt_seconds=v)


def _least_squares_course(record: LevitationRecord, estimate: ImmersionEstimate) -> ErrorCourse:
    rows, _ = thinned(record, LS_SAMPLE_TIME)
    error = np.linalg.norm(estimate.flux - record.flux[rows], axis=1) / sizes(record)[0]
    errors = (
        estimate.drift - record.drift[rows],
        estimate.current_bias - record.current_bias[rows],
    )
    relative = [
        np.linalg.norm(wrong, axis=1) / np.linalg.norm(true, axis=1).max()
        for wrong, true in zip(errors, (record.drift, record.current_bias), strict=True)
    ]
    parameters = np.linalg.norm(errors[0], axis=1)
    return ErrorCourse(record.t[rows], error, np.hypot(*relative), parameters)


def motor_courses(record: MotorRecord) -> dict[str, ErrorCourse]:
    """Run the observers on a PMSM with both biases; errors are those of λ - L i, divided by ψ.

    A current bias is equivalent to the offset (L s, s) of (λ, i), which leaves λ̂ - L i_m
    unchanged; therefore only the drift is estimated.
    """
    h, v, rows = record.h, jnp.asarray(record.volt_seconds), record.rows
    psi, L = record.machine.psi_f or 1.0, record.machine.L_s
    true = record.flux - L * (record.current - record.current_bias)
    constants = Parametrisation(record.constraint, "voltage-bias", SERVO_CORNER)
    skip = round(RUN_IN / SERVO_CORNER / h)
    half = len(record.t) // 2
    nominal = rows.part(slice(skip, half))
    Gamma = balanced_gain(np.asarray(nominal.Phi_flux), 100.0)
    regressor = np.asarray(constants.psi_record(nominal))

    def course(flux: object) -> ErrorCourse:
        error = np.linalg.norm(np.asarray(flux) - L * record.current - true, axis=1) / psi
        return ErrorCourse(record.t, error)

    def run_on_regression(observer: FluxObserver) -> ErrorCourse:
        return course(run(observer, h, v, rows, skip)[0])

    production = LeastSquaresObserver.for_machine(record.machine, sample_time=h)
    return {
        "voltage model": run_on_regression(VoltageModel(2)),
        "PEBO, least squares": run_on_regression(PEBO(2, "least-squares", Gamma)),
        "robust, balanced gain": run_on_regression(RobustObserver(Gamma, 2)),
        "adaptive, printed law": run_on_regression(
            PrintedAdaptiveObserver(balanced_gain(regressor, 100.0), constants)
        ),
        "adaptive, repaired": run_on_regression(
            balanced_repaired(nominal, constants, h, 100.0, 30.0, round(0.2 / h))
        ),
        "least squares": course(
            production.run(current=record.current, volt_seconds=record.volt_seconds).flux
        ),
    }
