"""Periodic orbits and poles of systems for which closed forms exist."""

import jax.numpy as jnp
import numpy as np
import pytest

from fluxobs import ModelError
from fluxobs.research import ElectromechanicalSystem, State, inertia
from fluxobs.research.energies.integrate import poles
from fluxobs.research.energies.orbit import periodic_orbit

R, L, SPEED, M, D, K = 2.0, 0.5, 3.0, 0.4, 0.3, 5.0


def choke_and_spring(resistance=R):
    """Return a choke and a damped spring without coupling."""
    return ElectromechanicalSystem(
        lambda flux, q: flux[0] ** 2 / (2 * L) + K * q[0] ** 2 / 2,
        inertia(M),
        R=[resistance],
        R_M=[D],
    )


def voltage(t, state):
    return jnp.array([jnp.cos(SPEED * t)])


def find_orbit(system):
    zero = jnp.zeros(1)
    return periodic_orbit(
        system,
        voltage,
        2 * np.pi / SPEED,
        64,
        State(zero, zero + 0.1, zero),
        State(zero + 1, zero + 1, zero + 1),
        stiff=False,
        rtol=1e-11,
    )


def test_orbit_and_multipliers_of_a_linear_system():
    """λ = Re(e^{jωt}/(R/L + jω)), and the multipliers are the exponentials of the poles."""
    orbit = find_orbit(choke_and_spring())
    t = orbit.trajectory.t
    exact = np.real(np.exp(1j * SPEED * t) / (R / L + 1j * SPEED))
    np.testing.assert_allclose(orbit.trajectory.flux[:, 0], exact, atol=1e-8)
    np.testing.assert_allclose(orbit.trajectory.position, 0, atol=1e-8)
    spring = np.roots([M, D, K])
    expected = np.exp(np.r_[-R / L, spring] * 2 * np.pi / SPEED)
    np.testing.assert_allclose(
        np.sort_complex(orbit.multipliers), np.sort_complex(expected), atol=1e-6
    )


def test_a_missing_orbit_is_reported():
    """Without resistance, a constant voltage has no periodic flux."""
    system = choke_and_spring(0.0)
    with pytest.raises(ModelError, match=r"no orbit of 2\.0944\d* s near the guess"):
        periodic_orbit(
            system,
            lambda t, state: jnp.ones(1),
            2 * np.pi / SPEED,
            64,
            State(*[jnp.zeros(1)] * 3),
            State(*[jnp.ones(1)] * 3),
            stiff=False,
            rtol=1e-9,
        )


def test_poles_of_a_linear_system():
    state = State(jnp.array([0.1]), jnp.array([0.2]), jnp.array([0.3]))
    eigenvalues = poles(choke_and_spring(), lambda t, state: -state.flux, state)
    expected = np.r_[-R / L - 1, np.roots([M, D, K])]
    np.testing.assert_allclose(np.sort_complex(eigenvalues), np.sort_complex(expected), rtol=1e-9)
    assert (np.diff(eigenvalues.real) <= 0).all()
