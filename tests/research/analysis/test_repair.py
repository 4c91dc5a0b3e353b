"""Repair of Proposition 2 without a hypothesis on Ω: both sides (docs/theorems.md, Theorem 5)."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fluxobs.machines import SurfacePMSM
from fluxobs.research.paper.pmsm import counter_example, motor_signals
from fluxobs.research.paper.stability import psi_on_orbit
from fluxobs.research.regression import Parametrisation
from fluxobs.research.regression.periodic import Orbit, periodic_regression

SAMPLES = 2048
H = 2 * np.pi / SAMPLES


@cache
def regressors(case):
    """Return (Φ_λ, Φ_θ) of a period, (samples, 2) and (samples, constants)."""
    if case == "S5":
        psi, _ = psi_on_orbit("S5", 0)
        units = 1 / np.sqrt(np.mean(psi**2, axis=0))
        units[2:4] = units[:2]  # the drift moves the flux by one unit per second
        return psi[:, :2] * units[:2], psi[:, 2:] * units[2:]
    if case == "counter-example":
        orbit = counter_example(SAMPLES)
        constraint, rows = orbit.constraint, orbit.rows
    else:  # constant speed
        machine = SurfacePMSM(R_s=0.05, L_s=0.4, n_p=1, psi_f=1.0)
        signals = motor_signals(machine, lambda time: time, lambda time: 0.5 + 0 * time)
        t = jnp.arange(SAMPLES) * H
        _, rate, current, _ = map(np.asarray, jax.jit(jax.vmap(signals))(t[:: SAMPLES // 256]))
        constraint = machine.constraint
        rows = periodic_regression(constraint, 1.0, Orbit(2 * np.pi, rate, current))
    psi = np.asarray(Parametrisation(constraint, "voltage-bias", 1.0).psi_record(rows))
    return psi[:, :2], psi[:, 2:]


def gramian(flux, constants, h, start):
    """Return ∫ FᵀCᵀCF over a period that begins at a sample: the flux moves with the drift."""
    n = len(flux)
    order = (start + np.arange(n)) % n
    C = np.hstack([flux, constants])[order]
    t = h * np.arange(n)
    moved = C.copy()
    moved[:, 2:4] += t[:, None] * C[:, :2]
    return h * moved.T @ moved


def excitation_of_omega(flux, constants, h, Gamma, start, U):
    """Return ∫ΩΩᵀ over the period, with U from an initial value by Heun's rule."""
    n = len(flux)
    drift = np.hstack([np.eye(2), np.zeros((2, constants.shape[1] - 2))])
    total = np.zeros((constants.shape[1], constants.shape[1]))

    def slope(U, k):
        a, b = flux[k % n], constants[k % n]
        return drift - np.outer(Gamma @ a, a @ U + b)

    for k in range(start, start + n):
        omega = U.T @ flux[k % n] + constants[k % n]
        total += h * np.outer(omega, omega)
        first = slope(U, k)
        U = U + h / 2 * (first + slope(U + h * first, k + 1))
    return total


@pytest.mark.parametrize("case", ["counter-example", "constant speed", "S5"])
@pytest.mark.parametrize(
    "gain",
    [1.0, *(pytest.param(gain, marks=pytest.mark.slow) for gain in (0.1, 10.0))],
)
def test_observability_makes_omega_persistently_exciting(case, gain):
    flux, constants = regressors(case)
    h = 2 * np.pi / len(flux)
    psi = np.hstack([flux, constants])
    rank = np.linalg.matrix_rank(h * psi.T @ psi, rtol=1e-9)
    # (pe2) fails at constant speed.
    assert rank == {"counter-example": 5, "constant speed": 3, "S5": 7}[case]
    Gamma = gain * np.array([[1.0, 0.3], [0.3, 0.6]])
    rng, shape = np.random.default_rng(2), (2, constants.shape[1])
    bound = np.linalg.eigvalsh(Gamma)[-1] * (flux**2).sum(axis=1).max() * 2 * np.pi / 2**0.5
    for start in (0, len(flux) // 3):
        alpha = np.linalg.eigvalsh(gramian(flux, constants, h, start))[0]
        assert alpha > 1e-6
        order = np.roll(np.arange(len(flux)), -start)
        assert np.linalg.eigvalsh(h * flux[order].T @ flux[order])[0] >= alpha
        for U in (np.zeros(shape), rng.standard_normal(shape)):
            excited = excitation_of_omega(flux, constants, h, Gamma, start, U)
            assert np.linalg.eigvalsh(excited)[0] >= 0.99 * alpha / (1 + bound) ** 2
