"""Relations found only from energies, and two properties of every machine in the library."""

from functools import cache
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fluxobs import ModelError, QuadraticConstraint, SurfacePMSM, SynchronousReluctance
from fluxobs.machines import example
from fluxobs.machines.model.constraint import invisible_offsets
from fluxobs.research import (
    ElectromechanicalSystem,
    blondel_park,
    check_constraint,
    discover_constraint,
    discover_in_features,
    inertia,
    linear_magnetics,
)
from fluxobs.research.energies.discovery import relative_residual
from fluxobs.research.energies.library import (
    LIBRARY,
    differential_relation,
    doubly_fed,
    interior_pmsm,
    knospe,
    maglev_1dof,
    maglev_biased,
    saturated_switched_reluctance,
    surface_pmsm,
    switched_reluctance,
    synchronous_reluctance,
    wound_field,
)

ROOT = Path(__file__).parents[3]

#: Machine → number of quadratic relations, number of invisible directions, Blondel-Park property.
EXPECTED = {
    "surface_pmsm": (1, 2, True),
    "interior_pmsm": (0, None, True),
    "synchronous_reluctance": (1, 0, True),
    "five_phase_pmsm": (4, 4, True),
    "wound_field": (2, 0, True),
    "doubly_fed": (6, 0, True),
    "maglev_1dof": (0, None, False),
    "knospe": (1, 0, False),
    "maglev_leakage": (1, 0, False),
    "maglev_biased": (1, 0, False),
    "four_pole_bearing": (2, 0, False),
    "three_coils": (3, 0, False),
    "affine_pair": (1, 0, False),
    "switched_reluctance": (0, None, False),
    "saturated_switched_reluctance": (0, None, False),
    "differential_actuator": (1, 0, False),
}


def test_every_machine_is_in_the_table():
    assert {make.__name__ for make in LIBRARY} == set(EXPECTED)


#: A machine with its relations is compiled once for all tests.
system_of = cache(lambda make: make())
discovered = cache(lambda make: discover_constraint(system_of(make)))
#: One relation and a transformable machine; neither. Other tests use the other machines.
QUICK = {"synchronous_reluctance", "maglev_1dof"}


@pytest.mark.parametrize(
    "make",
    [
        pytest.param(
            make, id=make.__name__, marks=() if make.__name__ in QUICK else pytest.mark.slow
        )
        for make in LIBRARY
    ],
)
def test_relations_and_transformability(make):
    count, hidden, transformable = EXPECTED[make.__name__]
    system, discovery = system_of(make), discovered(make)
    assert len(discovery.relations) == count
    if count:
        assert discovery.margin > 1e9
        assert discovery.residual < 1e-12
        assert discovery.invisible.shape[1] == hidden
        assert check_constraint(system, discovery.relations, seed=7) < 1e-12
    else:
        assert discovery.margin < 1e3  # certainly no null space
        assert discovery.smallest > 1e-4
    park = blondel_park(system)
    assert park.transformable == transformable
    assert np.all(park.residual < 1e-12 if transformable else park.residual > 0.1)


def assert_proportional(relation: QuadraticConstraint, expected: QuadraticConstraint) -> None:
    """Assert that two relations are equal up to a factor."""

    def terms(c):
        return np.concatenate([c.Q1.ravel(), c.Q2.ravel(), c.Q3.ravel(), c.E, c.C, [c.d]])

    a, b = terms(relation), terms(expected)
    factor = a[np.argmax(np.abs(b))] / b[np.argmax(np.abs(b))]
    np.testing.assert_allclose(a, factor * b, rtol=1e-9, atol=1e-9 * np.abs(a[a != 0]).min())


def test_known_relations_are_found():
    (relation,) = discover_constraint(surface_pmsm(L_s=1e-3, psi_f=0.02)).relations
    assert_proportional(relation, SurfacePMSM(R_s=1, L_s=1e-3, n_p=4, psi_f=0.02).constraint)
    (relation,) = discovered(synchronous_reluctance).relations
    assert_proportional(
        relation, SynchronousReluctance(R_s=1, L_d=0.05, L_q=0.01, n_p=2).constraint
    )
    machine = example("maglev-knospe")
    c = np.diag([machine.c_1, machine.c_2])
    core = machine.constraint  # relation in core fluxes φ; the system's fluxes are c φ
    (relation,) = discover_constraint(knospe()).relations
    inverse = np.linalg.inv(c)
    assert_proportional(
        relation, QuadraticConstraint(inverse @ core.Q1 @ inverse, inverse @ core.Q2, core.Q3)
    )
    (relation,) = discover_constraint(LIBRARY[-1]()).relations
    assert_proportional(relation, differential_relation())


def test_magnet_bias_needs_the_linear_term():
    k, g, magnet = 1e-5, 1e-3, 0.8
    (relation,) = discover_constraint(maglev_biased(k, g, magnet)).relations
    swap = np.array([[0.0, 1.0], [1.0, 0.0]])
    assert_proportional(
        relation,
        QuadraticConstraint(g * swap, -k * swap, np.zeros((2, 2)), E=-k * magnet * np.ones(2)),
    )


def test_wound_field_relations_of_the_theory():
    """(λ-L_q i)ᵀ(λ-L_d i) = ΔL P i_F + M² i_F², ΔL P² + M² P i_F = M² (λ-L_q i)ᵀi hold (f = 1)."""
    L_d, L_q, L_F, M = 8e-3, 5e-3, 0.6, 0.05
    system = wound_field(L_d, L_q, L_F, M)
    flux, position = system.random_states(np.random.default_rng(2), 500)
    i = np.asarray(jax.jit(jax.vmap(system.current))(flux, position))
    x, i_s, i_F = np.asarray(flux)[:, :2], i[:, :2], i[:, 2]
    P = np.asarray(flux)[:, 2] - L_F * i_F
    first = np.sum((x - L_q * i_s) * (x - L_d * i_s), axis=1)
    np.testing.assert_allclose(
        first, (L_d - L_q) * P * i_F + M**2 * i_F**2, atol=1e-10 * np.abs(first).max()
    )
    second = M**2 * np.sum((x - L_q * i_s) * i_s, axis=1)
    np.testing.assert_allclose(
        second, (L_d - L_q) * P**2 + M**2 * P * i_F, atol=1e-10 * np.abs(second).max()
    )
    # Both relations are in the span of the relations found.
    for relation in discover_constraint(system).relations:
        assert relative_residual(relation, np.asarray(flux), i).max() < 1e-12


def test_a_cage_machine_has_no_relation():
    """If the rotor ports are not measured, the stator ports alone obey no relation."""
    discovery = discover_constraint(system_of(doubly_fed), ports=(0, 1))
    assert not discovery
    assert discovery.smallest > 1e-3


def test_higher_relations_state_their_degree_in_flux():
    discovery = discover_constraint(switched_reluctance(L_0=10e-3), degree=3)
    (linear,) = [relation for relation in discovery.higher if relation.degree_in_flux == 1]
    # λ1 i2 i3 + λ2 i1 i3 + λ3 i1 i2 = 3 L_0 i1 i2 i3
    assert linear.degree == 3
    np.testing.assert_allclose(np.sort(linear.coefficients), [-0.03, 1, 1, 1], rtol=1e-9)
    (quartic,) = discover_constraint(system_of(interior_pmsm), degree=4).higher
    assert (quartic.degree, quartic.degree_in_flux) == (4, 4)
    for make in (maglev_1dof, saturated_switched_reluctance):
        assert not discover_constraint(system_of(make), degree=4).higher


def phase_features(variable, names):
    """Return features of three phases with their names."""
    return {name: (lambda x, i, k=k: variable(x, i)[:, k]) for k, name in enumerate(names)}


def test_saturation_uncovered_by_features():
    """z = -ln(1 - λ/ψ_s) = i (a + b cos) obeys the relation of the unsaturated machine."""
    psi_s, a, b = 0.5, 0.05, 0.03
    features = phase_features(lambda x, i: -np.log(1 - x / psi_s), ("z1", "z2", "z3"))
    features |= phase_features(lambda x, i: i, ("i1", "i2", "i3"))
    discovery = discover_in_features(saturated_switched_reluctance(psi_s, a, b), features, degree=3)
    assert discovery.margin > 1e10
    quadratic, linear = discovery.relations
    assert str(linear) == "+1 z1 i2 i3 +1 z2 i1 i3 +1 z3 i1 i2 -0.15 i1 i2 i3 = 0"
    np.testing.assert_allclose(linear.coefficients, [1, 1, 1, -3 * a], rtol=1e-9)
    # Σ L_j L_k = 3 a² - ¾ b², for L_k = a + b cos(q - 2πk/3).
    np.testing.assert_allclose(
        quadratic.coefficients, [1, 1, 1, -(3 * a**2 - 0.75 * b**2)], rtol=1e-9
    )
    # A wrong saturation flux does not linearise the relation.
    wrong = phase_features(lambda x, i: -np.log(1 - x / 0.6), ("z1", "z2", "z3"))
    assert not discover_in_features(
        saturated_switched_reluctance(psi_s, a, b), features | wrong, degree=3
    ).relations


@pytest.mark.parametrize(
    ("features", "degree", "message"),
    [
        ({}, 2, "at least one feature"),
        ({"x": lambda x, i: x}, 2, r"feature x must return \(.*\), got shape"),
        ({"x": lambda x, i: np.log(-x[:, 0])}, 2, "feature x is not finite at flux"),
        ({"x": lambda x, i: x[:, 0]}, 5, "degree must be 1, 2, 3 or 4"),
    ],
)
def test_bad_features(features, degree, message):
    with pytest.raises(ModelError, match=message):
        discover_in_features(switched_reluctance(), features, degree)


def test_a_higher_relation_beside_a_quadratic_one():
    """An affine pair and a saturating choke, i = λ + λ³, have one relation each, no products."""

    def magnetic_energy(flux, position):
        L = 10e-3 + jnp.array([0.5, -0.5]) * position[0]
        return jnp.sum(flux[:2] ** 2 / L) / 2 + flux[2] ** 2 / 2 + flux[2] ** 4 / 4

    system = ElectromechanicalSystem(
        magnetic_energy,
        inertia(0.1),
        R=[1.0] * 3,
        R_M=[0.0],
        flux_range=(-np.array([0.01, 0.01, 1.0]), np.array([0.01, 0.01, 1.0])),
        position_range=(-0.015, 0.015),
    )
    discovery = discover_constraint(system, degree=3)
    assert len(discovery.relations) == 1
    (cubic,) = discovery.higher
    assert (cubic.degree, cubic.degree_in_flux) == (3, 3)
    terms = dict(zip(map(tuple, cubic.exponents), cubic.coefficients, strict=True))
    assert terms == pytest.approx(
        {(0, 0, 3, 0, 0, 0): 1, (0, 0, 1, 0, 0, 0): 1, (0,) * 5 + (1,): -1}
    )


def test_products_of_quadratic_relations_are_not_reported():
    discovery = discover_constraint(system_of(surface_pmsm), degree=3)
    assert len(discovery.relations) == 1
    assert not discovery.higher


def test_a_failed_check_states_residual_and_state():
    right = SurfacePMSM(R_s=1, L_s=0.6e-3, n_p=4, psi_f=0.0125).constraint
    assert check_constraint(system_of(surface_pmsm), right) < 1e-12
    wrong = SurfacePMSM(R_s=1, L_s=0.7e-3, n_p=4, psi_f=0.0125).constraint
    with pytest.raises(
        ModelError, match=r"does not hold: relative residual .* at flux \[.*position"
    ):
        check_constraint(system_of(surface_pmsm), wrong)
    with pytest.raises(ModelError, match="the relation has 2 ports, the system has 4"):
        check_constraint(system_of(doubly_fed), right)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"degree": 5}, "degree must be 2, 3 or 4"),
        ({"ports": (0, 7)}, "ports must be some of"),
        ({"ports": (0, 0)}, "each once"),
    ],
)
def test_bad_arguments(arguments, message):
    with pytest.raises(ModelError, match=message):
        discover_constraint(system_of(surface_pmsm), **arguments)


def partly_undefined(flux, position):
    """Return the energy of a PMSM, which is NaN above 2.5 rad."""
    axis = jnp.array([jnp.cos(position[0]), jnp.sin(position[0])])
    hole = jnp.sqrt(2.5 - position[0])
    return jnp.sum((flux - 0.5 * axis) ** 2) * hole / hole


def test_currents_that_are_not_finite_are_refused():
    with pytest.raises(ModelError, match="magnetic_energy or its gradient is not finite"):
        ElectromechanicalSystem(partly_undefined, inertia(1.0), R=[1.0, 1.0], R_M=[0.0])
    narrow = ElectromechanicalSystem(
        partly_undefined, inertia(1.0), R=[1.0, 1.0], R_M=[0.0], position_range=(-1.0, 1.0)
    )
    wide = eqx.tree_at(lambda system: system.position_range, narrow, jnp.array([[-4.0], [4.0]]))
    arbitrary = QuadraticConstraint(np.eye(2), np.zeros((2, 2)), np.zeros((2, 2)))
    for call in (lambda: check_constraint(wide, arbitrary), lambda: discover_constraint(wide)):
        with pytest.raises(ModelError, match="the current is not finite at flux"):
            call()


def test_a_badly_scaled_system_gives_a_warning_instead_of_a_relation():
    system = ElectromechanicalSystem(
        linear_magnetics(
            lambda q: 1e-3 * jnp.eye(2),
            lambda q: 0.05 * jnp.array([jnp.cos(q[0]), jnp.sin(q[0])]),
        ),
        inertia(1.0),
        R=[1.0, 1.0],
        R_M=[0.0],
        flux_range=(-1000.0, 1000.0),
    )
    discovery = discover_constraint(system)
    assert not discovery
    assert "narrow flux_range" in discovery.warning


def one_coil(travel):
    """Return a coil with λ = k i/(g - q) and q up to `travel` times the gap."""
    k, g = 1e-5, 1e-3
    return ElectromechanicalSystem(
        linear_magnetics(lambda q: jnp.diag(jnp.array([k / (g - q[0])]))),
        inertia(0.5),
        R=[1.0],
        R_M=[0.0],
        flux_range=(1e-3, 1e-2),
        position_range=(-travel * g, travel * g),
    )


@pytest.mark.parametrize(
    ("make", "size", "remedy"),
    [
        (lambda: interior_pmsm(L_d=0.5e-3 * (1 + 1e-5)), 6.5e-12, "change this parameter"),
        (lambda: synchronous_reluctance(L_d=0.01 * (1 + 1e-7)), 2.5e-8, "change this parameter"),
        (lambda: one_coil(1e-6), 2.4e-7, "widen position_range"),
    ],
)
def test_an_approximate_relation_is_reported_with_size_and_remedy(make, size, remedy):
    """Saliencies of 1e-5 and 1e-7 and a coil with little travel have approximate relations."""
    discovery = discover_constraint(make())
    assert not discovery.relations
    assert discovery.approximate[0].size == pytest.approx(size, rel=0.5)
    assert remedy in discovery.warning


def test_far_from_these_values_no_relation_is_doubtful():
    for clear in (system_of(interior_pmsm), one_coil(0.8)):
        assert discover_constraint(clear).warning == ""


def test_an_approximate_relation_is_the_relation_of_the_nearest_machine():
    """A saliency of 1e-5 gives the surface machine's |λ - L i|² = ψ² within 1e-11."""
    (near,) = discover_constraint(interior_pmsm(L_d=0.5e-3 * (1 + 1e-5))).approximate
    terms = dict(zip(map(tuple, near.relation.exponents), near.relation.coefficients, strict=True))
    assert terms[(0, 2, 0, 0)] == pytest.approx(terms[(2, 0, 0, 0)])
    assert terms[(1, 0, 1, 0)] == pytest.approx(-2 * 0.5e-3, rel=1e-4)
    assert terms[(0, 0, 0, 0)] == pytest.approx(-(0.07**2), rel=1e-4)


def test_a_port_without_current_and_one_independent_of_position():
    """Affine relations are eliminated; the other relations and transformability are found."""

    def magnetic_energy(flux, position):
        axis = jnp.array([jnp.cos(position[0]), jnp.sin(position[0])])
        return jnp.sum((flux[:2] - axis) ** 2) / 2 + 30 * flux[2] ** 2

    system = ElectromechanicalSystem(magnetic_energy, inertia(1.0), R=[1.0] * 4, R_M=[0.0])
    discovery = discover_constraint(system)
    assert len(discovery.relations) == 1
    assert len(discovery.affine) == 2
    assert blondel_park(system).transformable


def test_pairs_of_very_different_size_are_equally_visible():
    """If the second of two opposed pairs is a millionth of the first, no direction is invisible."""
    swap = np.array([[0.0, 1.0], [1.0, 0.0]])
    blocks = [(1e-3 * swap, -1e-5 * k * swap) for k in (1.0, 1e-6)]
    relations = []
    for k, (Q1, Q2) in enumerate(blocks):
        big1, big2 = np.zeros((4, 4)), np.zeros((4, 4))
        block = slice(2 * k, 2 * k + 2)
        big1[block, block], big2[block, block] = Q1, Q2
        relations.append(QuadraticConstraint(big1, big2, np.zeros((4, 4))))
    assert invisible_offsets(relations).shape == (8, 0)


def test_a_machine_instead_of_a_system():
    with pytest.raises(
        ModelError, match="system must be an ElectromechanicalSystem, got SurfacePMSM"
    ):
        discover_constraint(example("servo-400w"))
    with pytest.raises(ModelError, match="no relation to check"):
        check_constraint(system_of(surface_pmsm), ())


def test_relations_together_leave_fewer_invisible_directions():
    relations = discovered(doubly_fed).relations
    alone = [invisible_offsets([relation]).shape[1] for relation in relations]
    assert max(alone) > invisible_offsets(relations).shape[1] == 0


def test_blondel_park_satisfies_the_matrix_identity():
    """U of the interior PMSM satisfies L′ = U L - L U and μ′ = U μ."""
    L_d, L_q, psi, n_p = 0.2e-3, 0.5e-3, 0.07, 4
    U = blondel_park(system_of(interior_pmsm)).U[0]
    angle = 0.7
    cos, sin = np.cos(n_p * angle), np.sin(n_p * angle)
    turn = np.array([[cos, -sin], [sin, cos]])
    slope = n_p * np.array([[-sin, -cos], [cos, -sin]])
    L = turn @ np.diag([L_d, L_q]) @ turn.T
    dL = slope @ np.diag([L_d, L_q]) @ turn.T + turn @ np.diag([L_d, L_q]) @ slope.T
    np.testing.assert_allclose(U @ L - L @ U, dL, atol=1e-12)
    np.testing.assert_allclose(U @ turn[:, 0] * psi, slope[:, 0] * psi, atol=1e-12)
