"""Studies besides the error courses: excitation, parameters, bound, scaling with bias, noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.arrays import Array
from ...observers.levitation_tracker import LevitationTracker
from ...simulation.closed_form.sensors import Sensor, Steps
from ..analysis import balanced_gain, bound_on_record, excitation, observability_gramian
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

#: Window of the excitation [s]: three periods of the slowest component of the reference.
WINDOW = 2.0


@dataclass(frozen=True)
class Excited:
    """Eigenvalue ratios (smallest over largest, per-unit) over :data:`WINDOW`, before the jump.

    Attributes
    ----------
    flux : float
        For Φ_λ, (pe1).
    all_constants : float
        For Ψ with unknowns (λ, θ, δ_i, θᵀQ1θ), (pe2).
    observability : float
        For the observability Gramian, in which the drift moves the flux.
    weakest : dict
        Direction that this Gramian sees least: share of flux, drift and current bias, per-unit.
    """

    flux: float
    all_constants: float
    observability: float
    weakest: dict[str, float]


def _nominal(given: LevitationRun) -> tuple[Regressors, int, int]:
    skip = round(RUN_IN / CORNER / given.given.h) + round(1.0 / given.given.h)
    jump = int(np.searchsorted(given.given.t, given.given.jump))
    return given.rows.part(slice(skip, jump)), skip, jump


def excited(given: LevitationRun) -> Excited:
    """Computes the excitation of a scenario."""
    rows, _, _ = _nominal(given)
    h, size = given.given.h, sizes(given.given)[1]
    constants = Parametrisation(given.given.constraint, "structured", CORNER)
    psi = np.asarray(constants.psi_record(rows))
    thin = slice(None, None, 5)
    flux = excitation(np.asarray(rows.Phi_flux)[thin], 5 * h, WINDOW)
    # Scale each column to unit rms: the ratio then shows only how alike they are.
    full = excitation((psi / np.sqrt(np.mean(psi**2, axis=0)))[thin], 5 * h, WINDOW)
    gramian = observability_gramian(rows, constants, h, WINDOW, size)
    scale = 1 / np.sqrt(np.diag(gramian))
    values, vectors = np.linalg.eigh(scale[:, None] * gramian * scale)
    # Back to per-unit unknowns: how much of each is in the direction seen least.
    weakest = np.abs(scale * vectors[:, 0])
    weakest /= np.linalg.norm(weakest)
    parts = {"flux": slice(0, 2), "drift": slice(2, 4), "current bias": slice(4, 6)}
    return Excited(
        flux.ratio,
        full.ratio,
        float(max(values[0], 0) / values[-1]),
        {name: float(np.linalg.norm(weakest[part])) for name, part in parts.items()},
    )


@dataclass(frozen=True)
class ConstantEstimate:
    """What the least squares knows of one constant over the last fifth of a span.

    Attributes
    ----------
    true, estimate, std : (float, float)
        At the end, at the end, and median [V] or [A].
    known : float
        Share of samples in which the observer itself says so: `valid`, for the current bias
        `current_bias_valid`.
    """

    true: tuple[float, float]
    estimate: tuple[float, float]
    std: tuple[float, float]
    known: float


def parameters(given: LevitationRun) -> dict[str, dict[str, ConstantEstimate]]:
    """Drift and current bias at the end of either span: "before" and "after" the jump."""
    base, found = given.given, given.least_squares
    rows, _ = thinned(base, LS_SAMPLE_TIME)
    last = int(np.searchsorted(base.t[rows], base.jump - LS_SAMPLE_TIME / 2)) - 1

    def pair(values: Array, row: int) -> tuple[float, float]:
        return float(values[row, 0]), float(values[row, 1])

    out = {}
    for name, first, row in (("before", 0, last), ("after", last + 1, len(rows) - 1)):
        late = slice(row - (row - first) // 5, row + 1)
        out[name] = {
            "drift": ConstantEstimate(
                pair(base.drift[rows], row),
                pair(found.drift, row),
                pair(np.median(found.drift_std[late], axis=0)[None], 0),
                float(found.valid[late].mean()),
            ),
            "current bias": ConstantEstimate(
                pair(base.current_bias[rows], row),
                pair(found.current_bias, row),
                pair(np.median(found.current_bias_std[late], axis=0)[None], 0),
                float(found.current_bias_valid[late].mean()),
            ),
        }
    return out


@dataclass(frozen=True)
class Robust:
    """Proposition 1 with the balanced gain on one scenario.

    Attributes
    ----------
    rms : dict
        Bias factor → relative rms flux error over the second half of the time before the jump.
    bound, largest : float
        Corrected bound in steady state, and the largest error there; both relative.
    """

    rms: dict[float, float]
    bound: float
    largest: float


def robust(given: LevitationRun) -> Robust:
    """Scales the biases, and compares the corrected bound with the error."""
    base = given.given
    nominal, skip, jump = _nominal(given)
    Gamma = balanced_gain(np.asarray(nominal.Phi_flux), FLUX_RATE)
    size = sizes(base)[0]
    late = slice((skip + jump) // 2, jump)
    rms, largest = {}, 0.0
    for factor in (0.5, 1.0, 2.0):
        changed = measured(base.scenario, base.machine, base.trajectory, base.jump, factor)
        regression, _ = filtered(changed)
        found = converged_run(changed, regression, Gamma, None, skip)
        error = np.linalg.norm(found.error, axis=1)[late] / size
        rms[factor] = float(np.sqrt(np.mean(error**2)))
        if factor == 1.0:
            largest = float(error.max())
    constants = Parametrisation(base.constraint, "structured", CORNER)
    thin = nominal.part(slice(None, None, 5))
    drift, bias = base.drift[0], base.current_bias[0]
    bound = bound_on_record(thin, constants, Gamma, 5 * base.h, WINDOW, 0.0, drift, bias, t=np.inf)
    return Robust(rms, float(bound / size), largest)


@dataclass(frozen=True)
class Noisy:
    """Result of the least squares under sensor noise.

    Attributes
    ----------
    error, claimed : float
        Rms flux error after 2 s, true and from the covariance; relative.
    noise_share : float
        Noise share of the larger flux component, median over time.
    valid : float
        Share of samples that the observer calls valid.
    """

    error: float
    claimed: float
    noise_share: float
    valid: float


def with_noise(given: LevitationRecord) -> tuple[Array, Array]:
    """Currents and volt-seconds with 1 mA and 10 mV of white noise at 1 kHz, in converter steps of
    0.5 mA and 5 mV."""
    machine, h = given.machine, given.h
    current_sensor = Sensor(Steps(np.zeros((1, 2))), noise=1e-3, quantum=5e-4)
    voltage_sensor = Sensor(Steps(np.zeros((1, 2))), noise=1e-2, quantum=5e-3)
    current = current_sensor.measure(given.t, given.current, seed=1)
    voltage = given.trajectory.voltage
    wrong_i = current - given.current
    wrong_u = voltage_sensor.measure(given.t, voltage, seed=2) - voltage
    mean_i = (wrong_i + np.roll(wrong_i, 1, axis=0)) / 2
    v = given.volt_seconds + h * (wrong_u @ machine.B.T - mean_i @ machine.R.T)
    v[0] = 0.0
    return current, v


def noisy(given: LevitationRecord, duration: float, memory: float) -> Noisy:
    """Least squares on the noisy record; `memory` and first `duration` in s."""
    rows = slice(0, round(duration / given.h) + 1)
    t = given.t[rows]
    current, v = with_noise(given)
    current, v = current[rows], v[rows]
    observer = levitation_observer(given.machine, given.h, memory, (1e-3, 1e-2))
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
    """Rms errors of position [m] and velocity [m/s] from the least squares' flux, between the first
    second and the jump."""
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
