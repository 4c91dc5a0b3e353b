"""Every observer on the same record; relative errors over time."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ..design.analysis import (
    balanced_basis,
    balanced_gain,
    balanced_repaired,
    observability_gramian,
)
from ..design.regression import Parametrisation, Regressors
from ..design.regression.laws import (
    PEBO,
    DremObserver,
    FluxObserver,
    PrintedAdaptiveObserver,
    RiccatiObserver,
    RobustObserver,
    VoltageModel,
    run,
)
from ..model.immersion import Immersion
from ..observers import LeastSquaresObserver
from ..observers.immersed import ImmersionEstimate, ImmersionObserver
from .levitation import ADAPTIVE_GAIN, CORNER, ROBUST_GAIN, LevitationRecord, filtered
from .pmsm import SERVO_CORNER, MotorRecord

Array = NDArray[np.float64]

#: The filters' transient is not used: e^{-15}.
RUN_IN = 15.0
#: Rates [1/s] of balanced gains on the levitation.
FLUX_RATE, CONSTANTS_RATE = 8.0, 2.0
#: Least squares on the levitation: sample time and memory [s]. The volt-seconds of a longer
#: interval are as exact as those of a shorter one.
LS_SAMPLE_TIME, LS_MEMORY = 1e-2, 0.1


@dataclass(frozen=True, eq=False)
class ErrorCourse:
    """How an observer did.

    Attributes
    ----------
    t : (rows,) ndarray
        [s].
    flux : (rows,) ndarray
        |λ̂ - λ| over the largest |λ|.
    constants : (rows,) ndarray or None
        |θ̂ - θ| over |θ|, per-unit; None where the observer has none.
    """

    t: Array
    flux: Array
    constants: Array | None = None

    def at(self, time: float) -> float:
        """Flux error at the first row not before `time`; infinite where it is not finite."""
        value = float(self.flux[min(int(np.searchsorted(self.t, time - 1e-9)), len(self.t) - 1)])
        return value if np.isfinite(value) else float("inf")

    def rms(self, start: float, stop: float) -> float:
        """Rms flux error over a span of time."""
        inside = (self.t >= start) & (self.t <= stop)
        return float(np.sqrt(np.mean(self.flux[inside] ** 2)))

    def first_below(self, level: float, since: float) -> float:
        """Time after `since` from which the error stays below; infinite where it never does.

        Until the next jump or the end: only rows up to `since` plus half the record count.
        """
        inside = (self.t >= since) & (self.t <= since + self.t[-1] / 2 - 1e-9)
        late = np.flatnonzero(~(self.flux[inside] < level))
        times = self.t[inside]
        if len(late) == 0:
            return 0.0
        return float("inf") if late[-1] == len(times) - 1 else float(times[late[-1] + 1] - since)


@dataclass(frozen=True, eq=False)
class LevitationRun:
    """A record, its regression, and the courses of all observers by name."""

    given: LevitationRecord
    rows: Regressors
    courses: dict[str, ErrorCourse]
    least_squares: ImmersionEstimate


def sizes(given: LevitationRecord) -> tuple[float, Array]:
    """Size of the flux, and of (λ, θ, δ_i, 2/ν θᵀQ1θ)."""
    flux = float(np.linalg.norm(given.flux, axis=1).max())
    drift, bias = np.abs(given.drift).max(), np.abs(given.current_bias).max()
    last = 2 / CORNER * given.machine.g * drift**2
    return flux, np.r_[flux, flux, drift, drift, bias, bias, last]


def _course(
    given: LevitationRecord, found: tuple[jax.Array, jax.Array], constants: Parametrisation | None
) -> ErrorCourse:
    flux, size = np.asarray(found[0]), sizes(given)[0]
    error = np.linalg.norm(flux - given.flux, axis=1) / size
    if constants is None:
        return ErrorCourse(given.t, error)
    # Two values each: before the jump and after it.
    before, after = (
        np.asarray(constants.constants(given.drift[k], given.current_bias[k])) for k in (0, -1)
    )
    true = np.where((given.t > given.jump)[:, None], after, before)
    # θ and the block that the current bias makes, each relative; the last constant says no more.
    parts = [slice(0, 2), slice(2, 4)]
    share = [
        np.linalg.norm((np.asarray(found[1]) - true)[:, part], axis=1)
        / np.linalg.norm(true[:, part], axis=1).max()
        for part in parts
    ]
    return ErrorCourse(given.t, error, np.hypot(*share))


def levitation_run(given: LevitationRecord, all_observers: bool = True) -> LevitationRun:
    """The paper's observers as printed and corrected, the repaired one, and the least squares."""
    rows, wrong = filtered(given)
    h, v = given.h, jnp.asarray(given.volt_seconds)
    skip = round(RUN_IN / CORNER / h)
    printed = Parametrisation(given.constraint, "printed", CORNER)
    structured = Parametrisation(given.constraint, "structured", CORNER)
    jump = int(np.searchsorted(given.t, given.jump))
    # Gains come from the excitation before the jump; a design run would do as well.
    nominal = Regressors(*(part[skip:jump] for part in rows))
    Gamma = balanced_gain(np.asarray(nominal.Phi_flux), FLUX_RATE)

    def course(
        observer: FluxObserver,
        constants: Parametrisation | None = None,
        regression: Regressors = rows,
    ) -> ErrorCourse:
        return _course(given, run(observer, h, v, regression, skip), constants)

    courses = {
        "robust, printed gain": course(RobustObserver(ROBUST_GAIN, 2)),
        "robust, balanced gain": course(RobustObserver(Gamma, 2)),
        "robust, balanced gain, printed Φ": course(RobustObserver(Gamma, 2), None, wrong),
        "adaptive, printed gain": course(PrintedAdaptiveObserver(ADAPTIVE_GAIN, printed), printed),
        "adaptive, printed gain and Φ": course(
            PrintedAdaptiveObserver(ADAPTIVE_GAIN, printed), printed, wrong
        ),
        "adaptive, ten times the gain": course(
            PrintedAdaptiveObserver(10 * np.array(ADAPTIVE_GAIN), printed), printed
        ),
        "adaptive, repaired": course(
            balanced_repaired(nominal, structured, h, FLUX_RATE, CONSTANTS_RATE, round(2.0 / h)),
            structured,
        ),
        "voltage model": course(VoltageModel(2)),
        "PEBO, least squares": course(PEBO(2, "least-squares", Gamma)),
    }
    if all_observers:
        size = sizes(given)[1]
        weight = float(np.sqrt(np.mean(np.square(nominal.Phi_flux)))) * size[0]
        courses["Riccati, memory 1 s"] = course(
            RiccatiObserver(1.0, size, 1e-6 * weight, structured), structured
        )
        window = 3.0
        gramian = observability_gramian(nominal, structured, h, window, size)
        basis = size[:, None] * balanced_basis(gramian, window)
        courses["DREM, finite time"] = course(DremObserver(1.0, 1.0, basis, structured), structured)
    estimate = least_squares(given)
    courses["least squares"] = _least_squares_course(given, estimate)
    return LevitationRun(given, rows, courses, estimate)


def thinned(given: LevitationRecord, sample_time: float) -> tuple[NDArray[np.int_], Array]:
    """Row numbers, and volt-seconds between them: sums, so nothing is lost."""
    step = round(sample_time / given.h)
    rows = np.arange(0, len(given.t), step)
    sums = np.cumsum(given.volt_seconds, axis=0)[rows]
    return rows, np.diff(sums, axis=0, prepend=sums[:1])


def least_squares(given: LevitationRecord) -> ImmersionEstimate:
    """Drift and current bias unknown, no noise."""
    machine = given.machine
    typical = machine.k_2 * 0.5 / machine.g
    observer = ImmersionObserver(
        Immersion((machine.constraint,), ("drift", "current-bias")),
        machine.R,
        machine.B,
        LS_SAMPLE_TIME,
        LS_MEMORY,
        flux_base=np.full(2, typical),
        constraint_noise=np.array([1e-6 * machine.g * typical**2]),
        drift_prior=np.full(2, 1e-5),
        current_bias_prior=np.full(2, 5e-3),
    )
    rows, v = thinned(given, LS_SAMPLE_TIME)
    return observer.run(current=given.current[rows], volt_seconds=v)


def _least_squares_course(given: LevitationRecord, estimate: ImmersionEstimate) -> ErrorCourse:
    rows, _ = thinned(given, LS_SAMPLE_TIME)
    error = np.linalg.norm(estimate.flux - given.flux[rows], axis=1) / sizes(given)[0]
    share = [
        np.linalg.norm(found - true[rows], axis=1) / np.linalg.norm(true, axis=1).max()
        for found, true in (
            (estimate.drift, given.drift),
            (estimate.current_bias, given.current_bias),
        )
    ]
    return ErrorCourse(given.t[rows], error, np.hypot(*share))


def motor_courses(given: MotorRecord) -> dict[str, ErrorCourse]:
    """The PMSM with both biases: error of the active flux λ - L i, over ψ.

    A current bias cannot be told from a flux offset (λ, i) + (L s, s), and λ̂ - L i_m is free of
    it; so drift alone is unknown.
    """
    h, v, rows = given.h, jnp.asarray(given.volt_seconds), given.rows
    psi, L = given.machine.psi_f or 1.0, given.machine.L_s
    true = given.flux - L * (given.current - given.current_bias)
    constants = Parametrisation(given.constraint, "voltage-bias", SERVO_CORNER)
    skip = round(RUN_IN / SERVO_CORNER / h)
    half = len(given.t) // 2
    nominal = Regressors(*(part[skip:half] for part in rows))
    Gamma = balanced_gain(np.asarray(nominal.Phi_flux), 100.0)
    regressor = np.asarray(constants.psi_record(nominal))

    def course(flux: object) -> ErrorCourse:
        error = np.linalg.norm(np.asarray(flux) - L * given.current - true, axis=1) / psi
        return ErrorCourse(given.t, error)

    def of(observer: FluxObserver) -> ErrorCourse:
        return course(run(observer, h, v, rows, skip)[0])

    production = LeastSquaresObserver.for_machine(given.machine, sample_time=h)
    return {
        "voltage model": of(VoltageModel(2)),
        "PEBO, least squares": of(PEBO(2, "least-squares", Gamma)),
        "robust, balanced gain": of(RobustObserver(Gamma, 2)),
        "adaptive, printed law": of(
            PrintedAdaptiveObserver(balanced_gain(regressor, 100.0), constants)
        ),
        "adaptive, repaired": of(
            balanced_repaired(nominal, constants, h, 100.0, 30.0, round(0.2 / h))
        ),
        "least squares": course(
            production.run(current=given.current, volt_seconds=given.volt_seconds).flux
        ),
    }
