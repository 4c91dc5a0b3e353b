"""Position from flux and current over the library: both sides of Theorem 7 (docs/theorems.md)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fluxobs.research import discover_constraint
from fluxobs.research.analysis import relation_gradients
from fluxobs.research.energies.library import (
    LIBRARY,
    four_pole_bearing,
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
NAMES = [make.__name__ for make in LIBRARY]


@pytest.mark.parametrize("make", LIBRARY, ids=NAMES)
def test_every_coordinate_of_the_library_is_visible(make):
    system = make()
    got = position_visibility(system)
    at_rest, positions = EXPECTED.get(make.__name__, (1, 1))
    assert (got.visible, got.relations) == (system.n_M, system.n_E - system.n_M)
    assert (got.at_rest, got.positions) == (at_rest, positions)


@pytest.mark.parametrize("make", LIBRARY, ids=NAMES)
def test_the_flux_acts_on_the_coordinates_that_the_current_shows(make):
    """∂F/∂λ = -(∂i/∂q)ᵀ, and q̇ follows from the rates of flux and current."""
    system = make()
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
    "make",
    [make for make in LIBRARY if make.__name__ not in WITHOUT_RELATION],
    ids=[name for name in NAMES if name not in WITHOUT_RELATION],
)
def test_relations_and_visible_coordinates_share_the_ports(make):
    """∇_i w is orthogonal to ∂i/∂q: independent relations + visible coordinates ≤ ports."""
    system = make()
    relations = discover_constraint(system).relations
    flux, q = system.random_states(np.random.default_rng(2), 8)
    current = np.asarray(jax.vmap(system.current)(flux, q))
    _, by_current = relation_gradients(relations, flux, current)
    for k in range(len(flux)):
        slope = np.asarray(current_by_position(system, flux[k], q[k]))
        products = by_current[k] @ slope
        size = np.linalg.norm(by_current[k], axis=1)[:, None] * np.linalg.norm(slope, axis=0)
        assert np.abs(products / size).max() < 1e-7
    units = np.linalg.norm(by_current, axis=2, keepdims=True)
    rank = np.linalg.matrix_rank(by_current[0] / units[0], tol=1e-6)
    assert rank == system.n_E - system.n_M


@pytest.mark.parametrize("make", [synchronous_reluctance, knospe, four_pole_bearing])
def test_ripples_of_a_machine_without_magnets_show_the_flux_without_its_parameters(make):
    """At rest, λᵀΔi = iᵀΔλ, because the inductances are symmetric."""
    system = make()
    flux, q = (values[0] for values in system.random_states(np.random.default_rng(8), 1))
    ripple = 0.03 * flux * jnp.cos(jnp.arange(system.n_E))
    current, rippled = system.current(flux, q), system.current(flux + ripple, q)
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
    np.testing.assert_array_equal(jax.jacfwd(lambda x: system.force(x, q[0]))(flux[0])[1], 0)


def test_the_ripple_at_rest_shows_the_inductance_at_constant_current():
    """Central differences of K at a displaced position whose flux gives the same current."""
    system = next(make for make in LIBRARY if make.__name__ == "interior_pmsm")()
    flux, q = (values[0] for values in system.random_states(np.random.default_rng(4), 1))
    current = system.current(flux, q)

    def K(q):
        moved = flux
        for _ in range(20):
            slope = jax.jacfwd(lambda x: system.current(x, q))(moved)
            moved = moved - jnp.linalg.solve(slope, system.current(moved, q) - current)
        return jax.jacfwd(lambda x: system.current(x, q))(moved)

    step = 1e-5
    expected = (K(q + step) - K(q - step)) / (2 * step)
    got = inverse_inductance_by_position(system, flux, q)[..., 0]
    np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())
    round_machine = inverse_inductance_by_position(
        surface_pmsm(), jnp.array([0.1, 0.2]), jnp.array([0.3])
    )
    assert np.abs(round_machine).max() < 1e-9
