"""Systems from energies: power balance, closed forms, a user's own system, wrong arguments."""

import runpy
from functools import cache
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fluxobs import ModelError
from fluxobs.research import ElectromechanicalSystem, State, inertia, linear_magnetics
from fluxobs.research.energies.library import (
    LIBRARY,
    differential_actuator,
    differential_relation,
    interior_pmsm,
    knospe,
    surface_pmsm,
    synchronous_reluctance,
)

ROOT = Path(__file__).parents[3]
SYSTEMS = {make.__name__: make for make in LIBRARY}


system_of = cache(lambda name: SYSTEMS[name]())


@eqx.filter_jit
def power(system, state, voltage, load):
    return system.power(state, voltage, load)


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(sorted(SYSTEMS)))
def test_power_balance(seed, name):
    """Stored = supplied - dissipated holds at any state for every machine of the library."""
    system, rng = system_of(name), np.random.default_rng(seed)
    flux, position = (states[0] for states in system.random_states(rng, 1))
    scale = np.abs(np.asarray(system.current(flux, position))).max()
    state = State(flux, position, jnp.asarray(rng.standard_normal(system.n_M)))
    voltage = jnp.asarray(scale * rng.standard_normal(system.B.shape[1]))
    load = jnp.asarray(rng.standard_normal(system.n_M))
    stored, supplied, dissipated = power(system, state, voltage, load)
    size = abs(stored) + abs(supplied) + dissipated
    # Conservative forces cancel between the two energies; their size bounds the rounding error.
    velocity = system.velocity(position, state.momentum)
    size += abs(system.force(flux, position) @ velocity)
    assert abs(stored - supplied + dissipated) <= 1e-11 * size
    assert dissipated >= 0


def test_pmsm_agrees_with_the_textbook():
    L, psi, n_p = 0.6e-3, 0.0125, 4
    system = surface_pmsm(L_s=L, psi_f=psi, n_p=n_p)
    q, i = jnp.array([0.3]), jnp.array([4.0, -2.0])
    axis = jnp.array([jnp.cos(n_p * q[0]), jnp.sin(n_p * q[0])])
    flux = L * i + psi * axis
    np.testing.assert_allclose(system.current(flux, q), i, rtol=1e-12)
    torque = n_p * (flux[0] * i[1] - flux[1] * i[0])
    np.testing.assert_allclose(system.force(flux, q)[0], torque, rtol=1e-12)


@pytest.mark.parametrize("make", [interior_pmsm, synchronous_reluctance])
def test_salient_torque(make):
    system = make()
    rng = np.random.default_rng(1)
    flux, q = (states[0] for states in system.random_states(rng, 1))
    i = system.current(flux, q)
    n_p = 4 if make is interior_pmsm else 2
    torque = n_p * (flux[0] * i[1] - flux[1] * i[0])
    np.testing.assert_allclose(system.force(flux, q)[0], torque, rtol=1e-10)


def test_maglev_force_agrees_with_the_benchmark():
    system = knospe()
    phi, q = jnp.array([3e-5, 2e-5]), jnp.array([5e-5])
    c, k, g = 293.5, 2.2e-8, 3.3e-4
    i = system.current(c * phi, q)
    np.testing.assert_allclose(i, phi * (g + np.array([-1, 1]) * 5e-5) / k, rtol=1e-12)
    force = c * (phi[0] ** 2 - phi[1] ** 2) / (2 * k)
    np.testing.assert_allclose(system.force(c * phi, q)[0], force, rtol=1e-12)
    # N φ̇ = u - R i.
    u = jnp.array([0.3, 0.1])
    rate = system.derivative(State(c * phi, q, jnp.zeros(1)), u).flux / c
    np.testing.assert_allclose(rate, (u - 1.6 * i) / 321, rtol=1e-12)


def test_the_electrostatic_dual_satisfies_its_relation():
    system, relation = differential_actuator(), differential_relation()
    charge, position = system.random_states(np.random.default_rng(0), 200)
    voltage = jax.vmap(system.current)(charge, position)
    size = np.abs(charge).max() ** 2 * 2e-6
    assert np.abs(relation.residual(charge, voltage)).max() < 1e-14 * size
    # A charged capacitor between plates has v = Q (g - q)/(ε A) and is attracted to its plate.
    assert system.force(jnp.array([1e-12, 0.0]), jnp.zeros(1))[0] > 0


def test_a_users_system_in_ten_lines(capsys):
    example = str(ROOT / "examples" / "dual_three_phase.py")
    machine = runpy.run_path(example, run_name="__main__")["machine"]
    assert (machine.n_E, machine.n_M) == (6, 1)
    printed = capsys.readouterr().out
    assert "1 quadratic relation" in printed
    assert "4 linear relations" in printed


def test_parameters_are_differentiable():
    """Energies are plain functions: JAX differentiates with respect to their parameters."""

    def torque(psi):
        system = linear_magnetics(
            lambda q: 1e-3 * jnp.eye(2),
            lambda q: psi * jnp.array([jnp.cos(q[0]), jnp.sin(q[0])]),
        )
        return -jax.grad(system, 1)(jnp.array([0.02, 0.05]), jnp.array([0.4]))[0]

    step = 1e-6
    slope = (torque(0.03 + step) - torque(0.03 - step)) / (2 * step)
    np.testing.assert_allclose(jax.grad(torque)(0.03), slope, rtol=1e-6)


VALID = {
    "magnetic_energy": linear_magnetics(lambda q: jnp.eye(2)),
    "mechanical_energy": inertia(1.0),
    "R": [1.0, 1.0],
    "R_M": [0.1],
}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"magnetic_energy": lambda x, q: x}, r"magnetic_energy must return one number.*\(2,\)"),
        ({"magnetic_energy": lambda x, q: jnp.log(x[0])}, "magnetic_energy or its gradient is not"),
        ({"magnetic_energy": lambda x, q: x[0] @ q}, "magnetic_energy fails at shapes"),
        ({"mechanical_energy": lambda q, p: p}, "mechanical_energy must return one number"),
        ({"R": [1.0, -1.0]}, "R must be positive semi-definite.*-1"),
        ({"R": [[1.0, 2.0]]}, "R must be square"),
        ({"R": np.ones(2, np.float32)}, "R is float32"),
        ({"R_M": [np.nan]}, "R_M must be finite"),
        ({"B": [[1.0], [1.0], [0.0]]}, "B must have 2 rows"),
        ({"B": [[1.0, 2.0], [1.0, 2.0]]}, "full column rank"),
        ({"flux_range": (1.0, 1.0)}, "low must be below high"),
    ],
)
def test_wrong_arguments(change, message):
    with pytest.raises((ModelError, ValueError), match=message):
        ElectromechanicalSystem(**(VALID | change))


def test_inertia_must_be_positive():
    with pytest.raises(ModelError, match="inertia must be positive"):
        inertia([1.0, 0.0])
