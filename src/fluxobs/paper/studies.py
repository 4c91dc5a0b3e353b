"""Numbers beside the courses: excitation, stability, bound, scaling with the bias, noise."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ..design.analysis import (
    balanced_gain,
    bound_on_record,
    excitation,
    observability_gramian,
    over_gain,
)
from ..design.regression import Parametrisation, Regressors
from ..design.regression.laws import RobustObserver, run
from ..model.immersion import Immersion
from ..observers.immersed import ImmersionObserver
from ..observers.levitation_tracker import LevitationTracker
from ..synthetic.sensors import Sensor, Steps
from .levitation import ADAPTIVE_GAIN, CORNER, LevitationRecord, filtered, measured
from .section_v import FLUX_RATE, LS_SAMPLE_TIME, RUN_IN, LevitationRun, sizes, thinned

Array = NDArray[np.float64]

#: Window of the excitation [s]: three periods of the reference's slowest part.
WINDOW = 2.0


@dataclass(frozen=True)
class Excited:
    """Eigenvalue ratios (smallest over largest, per-unit) over :data:`WINDOW`, before the jump.

    Attributes
    ----------
    flux : float
        Of Φ_λ: (pe1).
    all_constants : float
        Of Ψ with (λ, θ, δ_i, θᵀQ1θ): (pe2).
    observability : float
        Of the Gramian of the pair, the flux moving with the drift.
    """

    flux: float
    all_constants: float
    observability: float


def _nominal(given: LevitationRun) -> tuple[Regressors, int, int]:
    skip = round(RUN_IN / CORNER / given.given.h) + round(1.0 / given.given.h)
    jump = int(np.searchsorted(given.given.t, given.given.jump))
    return Regressors(*(part[skip:jump] for part in given.rows)), skip, jump


def excited(given: LevitationRun) -> Excited:
    """Excitation of a scenario."""
    rows, _, _ = _nominal(given)
    h, size = given.given.h, sizes(given.given)[1]
    constants = Parametrisation(given.given.constraint, "structured", CORNER)
    psi = np.asarray(constants.psi_record(rows))
    thin = slice(None, None, 5)
    flux = excitation(np.asarray(rows.Phi_flux)[thin], 5 * h, WINDOW)
    # Scale each column to unit rms: what is left is how alike they are.
    full = excitation((psi / np.sqrt(np.mean(psi**2, axis=0)))[thin], 5 * h, WINDOW)
    gramian = observability_gramian(rows, constants, h, WINDOW, size)
    scale = 1 / np.sqrt(np.diag(gramian))
    values = np.linalg.eigvalsh(scale[:, None] * gramian * scale)
    return Excited(flux.ratio, full.ratio, float(max(values[0], 0) / values[-1]))


def growth(given: LevitationRun, factors: tuple[float, ...]) -> dict[str, tuple[float, float]]:
    """Largest Lyapunov exponent of Proposition 2 over its gain matrix, and its uncertainty [1/s].

    Over 10 s before the jump; stiff gains need every row.
    """
    rows, _, _ = _nominal(given)
    span = 2 * (min(round(10.0 / given.given.h), len(rows.y) - 1) // 2) + 1
    constants = Parametrisation(given.given.constraint, "printed", CORNER)
    study = over_gain(
        Regressors(*(part[:span] for part in rows)),
        constants,
        given.given.h,
        factors,
        np.array(ADAPTIVE_GAIN),
        periodic=False,
    )
    return {
        f"{gain:g}": (float(value), float(error))
        for gain, value, error in zip(study.gains, study.growth, study.resolution, strict=True)
    }


@dataclass(frozen=True)
class Robust:
    """Proposition 1 with the balanced gain on one scenario.

    Attributes
    ----------
    rms : dict
        Bias factor → rms flux error over the second half before the jump, relative.
    bound, largest : float
        Corrected bound in steady state and largest error there, relative.
    """

    rms: dict[float, float]
    bound: float
    largest: float


def robust(given: LevitationRun) -> Robust:
    """Scaling of the error with the biases, and the corrected bound against the error."""
    base = given.given
    nominal, skip, jump = _nominal(given)
    Gamma = balanced_gain(np.asarray(nominal.Phi_flux), FLUX_RATE)
    size = sizes(base)[0]
    late = slice((skip + jump) // 2, jump)
    rms, largest = {}, 0.0
    for factor in (0.5, 1.0, 2.0):
        changed = measured(base.scenario, base.machine, base.trajectory, base.jump, factor)
        rows, _ = filtered(changed)
        found, _ = run(
            RobustObserver(Gamma, 2), base.h, jnp.asarray(changed.volt_seconds), rows, skip
        )
        error = np.linalg.norm(np.asarray(found) - base.flux, axis=1)[late] / size
        rms[factor] = float(np.sqrt(np.mean(error**2)))
        if factor == 1.0:
            largest = float(error.max())
    constants = Parametrisation(base.constraint, "structured", CORNER)
    thin = Regressors(*(part[::5] for part in nominal))
    drift, bias = base.drift[0], base.current_bias[0]
    bound = bound_on_record(thin, constants, Gamma, 5 * base.h, WINDOW, 0.0, drift, bias, t=np.inf)
    return Robust(rms, float(bound / size), largest)


@dataclass(frozen=True)
class Noisy:
    """Least squares under sensor noise.

    Attributes
    ----------
    error, claimed : float
        Rms flux error after 2 s; what its covariance says. Relative.
    noise_share : float
        Median over time of the larger component's.
    valid : float
        Share of samples claimed known.
    """

    error: float
    claimed: float
    noise_share: float
    valid: float


def noisy(
    given: LevitationRecord, unknowns: tuple[str, ...], duration: float, memory: float
) -> Noisy:
    """1 mA and 10 mV of white noise at 1 kHz, converters of 0.5 mA and 5 mV."""
    rows = slice(0, round(duration / given.h) + 1)
    t, machine, h = given.t[rows], given.machine, given.h
    current_sensor = Sensor(Steps(np.zeros((1, 2))), noise=1e-3, quantum=5e-4)
    voltage_sensor = Sensor(Steps(np.zeros((1, 2))), noise=1e-2, quantum=5e-3)
    current = current_sensor.measure(t, given.current[rows], seed=1)
    voltage = given.trajectory.voltage[rows]
    wrong_i = current - given.current[rows]
    wrong_u = voltage_sensor.measure(t, voltage, seed=2) - voltage
    mean_i = (wrong_i + np.roll(wrong_i, 1, axis=0)) / 2
    v = given.volt_seconds[rows] + h * (wrong_u @ machine.B.T - mean_i @ machine.R.T)
    v[0] = 0.0
    typical = machine.k_2 * 0.5 / machine.g
    slope = float(np.hypot(machine.k_1, machine.k_2)) * typical
    # What voltage noise puts into w within the memory, beside the current's own noise.
    walk = 2 * machine.g * typical * 1e-2 / machine.N * np.sqrt(h * memory)
    observer = ImmersionObserver(
        Immersion((machine.constraint,), unknowns),  # type: ignore[arg-type]
        machine.R,
        machine.B,
        h,
        memory,
        flux_base=np.full(2, typical),
        constraint_noise=np.array([np.hypot(slope * 1e-3, walk)]),
        drift_prior=np.full(2, 2e-5),
        current_bias_prior=np.full(2, 5e-3),
        current_noise=1e-3,
        voltage_noise=1e-2,
    )
    found = observer.run(current=current, volt_seconds=v)
    late = t >= 2.0
    size = sizes(given)[0]
    error = np.linalg.norm(found.flux - given.flux[rows], axis=1)[late] / size
    claimed = np.linalg.norm(found.flux_std, axis=1)[late] / size
    return Noisy(
        float(np.sqrt(np.mean(error**2))),
        float(np.sqrt(np.mean(claimed**2))),
        float(np.median(found.noise_share[late].max(axis=1))),
        float(found.valid[late].mean()),
    )


def mechanics(given: LevitationRun) -> tuple[float, float]:
    """Rms error of position [m] and velocity [m/s] from the least squares' flux, before the jump
    and after the first second."""
    base, estimate = given.given, given.least_squares
    rows, _ = thinned(base, LS_SAMPLE_TIME)
    tracker = LevitationTracker(base.machine, LS_SAMPLE_TIME)
    position, velocity = tracker.run(estimate.flux, base.current[rows] - estimate.current_bias)
    late = (base.t[rows] > 1.0) & (base.t[rows] < base.jump)
    truth = base.trajectory
    return (
        float(np.sqrt(np.mean((position - truth.position[rows, 0])[late] ** 2))),
        float(np.sqrt(np.mean((velocity - truth.velocity[rows, 0])[late] ** 2))),
    )
