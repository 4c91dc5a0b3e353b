"""The levitation from all rows of a record, and at rest: Theorems 8 and 9 on Section V-B."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from ...core.arrays import Array
from ...machines import MagLev2DOF
from ..energies.position import inverse_inductance_by_position
from ..relation_observer import RelationObserver
from ..relation_smoother import integrated_flux, smooth_record
from .levitation import CURRENT_BIAS, VOLTAGE_BIAS, LevitationRecord, benchmark
from .section_v import levitation_observer, sizes
from .studies import CURRENT_NOISE, VOLTAGE_NOISE, noise_std, with_noise

#: Memory of the least squares that starts the smoother [s].
MEMORY = 0.5
#: Rows over which the slopes of the relation average the current: 31 ms, against 0.3 s of the
#: fastest reference. Without it, S1 has a standard deviation of a third of its error.
WINDOW = 31
#: At rest: ripple of both currents [A], its period [samples], and duration [s].
RIPPLE, RIPPLE_PERIOD, AT_REST = 0.01, 4, 1.0


@dataclass(frozen=True)
class Smoothed:
    """Smoother on a noisy record; errors are relative to the largest flux.

    Attributes
    ----------
    error, claimed : float
        Rms flux error of all rows: true, and stated.
    within : float
        Share of flux components within two standard deviations.
    slope_uncertainty : float
        Of the smoother's result.
    valid : bool
        Whether the smoother says that its standard deviations hold.
    """

    error: float
    claimed: float
    within: float
    slope_uncertainty: float
    valid: bool


def levitation_relation(machine: MagLev2DOF, flux_size: float) -> RelationObserver:
    """Return the observer of the levitation's relation with current offsets as coefficients η.

    The residual is in units of the relation's largest term, 2g φ².
    """
    w = machine.constraint
    Q1, Q2 = jnp.asarray(w.Q1), jnp.asarray(w.Q2)
    unit = 2 * machine.g * flux_size**2

    def relation(flux: jax.Array, offset: jax.Array, current: jax.Array) -> jax.Array:
        return jnp.reshape(flux @ Q1 @ flux + flux @ Q2 @ (current - offset), 1) / unit

    current_std, voltage_std = noise_std()
    offset = float(np.abs(CURRENT_BIAS).max())
    drift = (machine.resistance * offset + float(np.abs(VOLTAGE_BIAS).max())) / machine.N
    return RelationObserver(
        relation,
        2,
        1e-3,
        flux_prior=2 * flux_size,
        drift_prior=2 * drift,
        current_noise=current_std,
        voltage_noise=voltage_std / machine.N,
        moving=np.zeros(2),
        moving_prior=np.full(2, offset),
        floor=1e-6,
    )


def smoothed(record: LevitationRecord, duration: float, seed: int = 1) -> Smoothed:
    """Smooth the first `duration` seconds of a record with the noise of Section V's study."""
    rows = slice(0, round(duration / record.h) + 1)
    current, v = (signal[rows] for signal in with_noise(record, seed))
    machine, size = record.machine, sizes(record)[0]
    noise = (CURRENT_NOISE, VOLTAGE_NOISE)
    first = levitation_observer(machine, record.h, MEMORY, noise).run(
        current=current, volt_seconds=v
    )
    start = integrated_flux(first.flux, first.drift, v, record.h)
    result = smooth_record(levitation_relation(machine, size), v, current, start, WINDOW)
    error = result.flux - record.flux[rows]
    return Smoothed(
        _rms(error) / size,
        _rms(result.flux_std) / size,
        float(np.mean(np.abs(error) < 2 * result.flux_std)),
        result.slope_uncertainty,
        result.valid,
    )


def _rms(vectors: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


@dataclass(frozen=True)
class AtRest:
    """The body at rest under a current ripple; the start of the estimate is in mid-gap.

    Attributes
    ----------
    position, flux : float
        Rms errors of position [m] and flux (relative).
    position_std, flux_std : float
        Their standard deviations according to the smoother.
    bound : float
        Closed form σ_q = σ_i/√Σ|K'Δλ|² [m].
    """

    position: float
    flux: float
    position_std: float
    flux_std: float
    bound: float


def at_rest(position: float = 1e-4, runs: int = 40, seed: int = 0) -> AtRest:
    """Estimate flux and position of the levitation at rest; the voltages are exact.

    At rest, all of ``i = ∇_λ H_E(λ, q)`` is a relation, with q as a constant (Theorem 9).
    """
    machine, system = benchmark()
    c = np.array([machine.c_1, machine.c_2])
    size = machine.k_2 * 0.5 / machine.g
    rows = round(AT_REST / 1e-3)
    # The flux ripples by RIPPLE amperes in mid-gap, in opposite phases.
    wave = np.sign(np.sin(2 * np.pi * (np.arange(rows) + 0.5) / RIPPLE_PERIOD))
    flux = c * size + np.outer(wave, c * machine.k_2 * RIPPLE / machine.g * np.array([1, -1]))
    q = jnp.array([position])
    current = np.asarray(jax.vmap(lambda x: system.current(x, q))(jnp.asarray(flux)))
    current_std, _ = noise_std()
    observer = RelationObserver(
        lambda flux, q, current: (system.current(flux, q) - current) / current_std,
        2,
        1e-3,
        flux_prior=0.5 * c * size,
        drift_prior=1e-12 * c,
        current_noise=current_std,
        start=c * size,
        moving=np.zeros(1),
        moving_prior=np.full(1, machine.g / 2),
        floor=1e-6,
    )
    v = np.diff(flux, axis=0, prepend=flux[:1])
    rng = np.random.default_rng(seed)
    errors, stds = [], []
    for _ in range(runs):
        result = smooth_record(observer, v, current + current_std * rng.standard_normal(flux.shape))
        error = (result.flux - flux)[-1] / (c * size)
        errors.append([result.moving[-1, 0] - position, *error])
        stds.append([result.moving_std[-1, 0], *(result.flux_std[-1] / (c * size))])
    rms, stated = (np.sqrt(np.mean(np.square(values), axis=0)) for values in (errors, stds))
    K = np.asarray(inverse_inductance_by_position(system, jnp.asarray(c * size), q))[..., 0]
    ripple = flux - flux.mean(axis=0)
    bound = current_std / np.sqrt(np.sum((ripple @ K.T) ** 2))
    return AtRest(
        float(rms[0]),
        float(np.linalg.norm(rms[1:]) / np.sqrt(2)),
        float(stated[0]),
        float(np.linalg.norm(stated[1:]) / np.sqrt(2)),
        float(bound),
    )
