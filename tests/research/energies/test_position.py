"""Position from flux and current over the library: both sides of Theorem 7 (docs/theorems.md)."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fluxobs.research import discover_constraint
from fluxobs.research.analysis import relation_gradients
from fluxobs.research.energies.library import (
    LIBRARY,
    four_pole_bearing,
    interior_pmsm,
    knospe,
    surface_pmsm,
    synchronous_reluctance,
)
from fluxobs.research.energies.position import (
    current_by_position,
    inverse_inductance_by_position,
    position_visibility,
    velocity_from_flux,
)
from fluxobs.research.energies.system import ElectromechanicalSystem, inertia, linear_magnetics
from support.relations import WITHOUT_RELATION

#: Machine → coordinates seen at rest, positions with one flux and current. A pole pair more is a
#: position more; without magnets and field, also half an electrical turn is.
EXPECTED = {
    "surface_pmsm": (0, 4),
    "interior_pmsm": (1, 4),
    "synchronous_reluctance": (1, 4),
    "five_phase_pmsm": (0, 3),
    "wound_field": (1, 2),
    "doubly_fed": (1, 2),
    "four_pole_bearing": (2, 1),
}

#: A machine is compiled once for all tests.
system_of = cache(lambda make: make())


def machines(*quick, without=()):
    """Return parameters for the machines of the library; all but `quick` are slow."""
    return [
        pytest.param(
            make,
            id=make.__name__,
            marks=() if make.__name__ in quick else pytest.mark.slow,
        )
        for make in LIBRARY
        if make.__name__ not in without
    ]


@pytest.mark.parametrize(
    "make", machines("surface_pmsm", "synchronous_reluctance", "maglev_1dof", "four_pole_bearing")
)
def test_every_coordinate_of_the_library_is_visible(make):
    system = system_of(make)
    got = position_visibility(system)
    at_rest, positions = EXPECTED.get(make.__name__, (1, 1))
    assert (got.visible, got.relations) == (system.n_M, system.n_E - system.n_M)
    assert (got.at_rest, got.positions) == (at_rest, positions)


@pytest.mark.parametrize("make", machines("maglev_1dof", "four_pole_bearing"))
def test_the_flux_acts_on_the_coordinates_that_the_current_shows(make):
    """∂F/∂λ = -(∂i/∂q)ᵀ, and q̇ follows from the rates of flux and current."""
    system = system_of(make)
    speed = jnp.linspace(0.5, -1.0, system.n_M) * (1e-3 if "Mag" in system.name else 1.0)

    @jax.jit
    def derivatives(flux, q):
        rate = flux * jnp.linspace(2.0, -3.0, system.n_E)
        _, current_rate = jax.jvp(system.current, (flux, q), (rate, speed))
        return (
            current_by_position(system, flux, q),
            jax.jacfwd(lambda flux: system.force(flux, q))(flux),
            velocity_from_flux(system, flux, q, rate, current_rate),
        )

    for flux, q in zip(*system.random_states(np.random.default_rng(5), 3), strict=True):
        slope, force, got = derivatives(flux, q)
        np.testing.assert_allclose(force, -slope.T, rtol=1e-8, atol=1e-8 * np.abs(slope).max())
        np.testing.assert_allclose(got, speed, rtol=1e-6)


@pytest.mark.parametrize(
    "make", machines("surface_pmsm", "four_pole_bearing", without=WITHOUT_RELATION)
)
def test_relations_and_visible_coordinates_share_the_ports(make):
    """∇_i w is orthogonal to ∂i/∂q: independent relations + visible coordinates ≤ ports."""
    system = system_of(make)
    relations = discover_constraint(system).relations
    flux, q = system.random_states(np.random.default_rng(2), 8)
    current = np.asarray(jax.jit(jax.vmap(system.current))(flux, q))
    _, by_current = relation_gradients(relations, flux, current)
    slopes = jax.jit(jax.vmap(lambda *state: current_by_position(system, *state)))(flux, q)
    for k, slope in enumerate(np.asarray(slopes)):
        products = by_current[k] @ slope
        size = np.linalg.norm(by_current[k], axis=1)[:, None] * np.linalg.norm(slope, axis=0)
        assert np.abs(products / size).max() < 1e-7
    units = np.linalg.norm(by_current, axis=2, keepdims=True)
    rank = np.linalg.matrix_rank(by_current[0] / units[0], tol=1e-6)
    assert rank == system.n_E - system.n_M


@pytest.mark.parametrize(
    "make",
    [synchronous_reluctance, four_pole_bearing, pytest.param(knospe, marks=pytest.mark.slow)],
)
def test_ripples_of_a_machine_without_magnets_show_the_flux_without_its_parameters(make):
    """At rest, λᵀΔi = iᵀΔλ, because the inductances are symmetric."""
    system = system_of(make)
    flux, q = (np.asarray(x)[0] for x in system.random_states(np.random.default_rng(8), 1))
    ripple = 0.03 * flux * np.cos(np.arange(system.n_E))
    current_at = jax.jit(lambda *state: system.current(*state))
    current, rippled = (np.asarray(current_at(x, q)) for x in (flux, flux + ripple))
    assert flux @ (rippled - current) == pytest.approx(float(current @ ripple), rel=1e-9)


def test_a_coordinate_without_force_is_invisible():
    """A slide beside a reluctance machine: H_E does not depend on its position."""

    def inductance(q):
        return jnp.array([[2.0 + jnp.cos(q[0]), 0.0], [0.0, 2.0 - jnp.cos(q[0])]])

    system = ElectromechanicalSystem(
        linear_magnetics(inductance), inertia([1.0, 1.0]), [1.0, 1.0], [0.0, 0.0], name="slide"
    )
    got = position_visibility(system)
    assert (got.visible, got.relations, got.at_rest, got.positions) == (1, 1, 1, 0)
    flux, q = system.random_states(np.random.default_rng(0), 1)
    slope = jax.jit(jax.jacfwd(system.force))(flux[0], q[0])
    np.testing.assert_array_equal(slope[1], 0)


def test_the_ripple_at_rest_shows_the_inductance_at_constant_current():
    """Central differences of K at a displaced position whose flux gives the same current."""
    system = system_of(interior_pmsm)
    flux, q = (np.asarray(x)[0] for x in system.random_states(np.random.default_rng(4), 1))
    # The current at a flux, and its slope.
    linear = jax.jit(lambda *at: (system.current(*at), jax.jacfwd(system.current)(*at)))
    current, _ = linear(flux, q)

    def K(q):
        moved = flux
        for _ in range(20):
            there, slope = linear(moved, q)
            moved = moved - np.linalg.solve(slope, there - current)
        return np.asarray(linear(moved, q)[1])

    step = 1e-5
    expected = (K(q + step) - K(q - step)) / (2 * step)
    by_position = eqx.filter_jit(inverse_inductance_by_position)
    got = by_position(system, flux, q)[..., 0]
    np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())
    round_machine = by_position(system_of(surface_pmsm), jnp.array([0.1, 0.2]), jnp.array([0.3]))
    assert np.abs(round_machine).max() < 1e-9
