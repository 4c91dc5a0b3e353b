"""Excitation and observability from the relation's gradient: both sides (docs/theorems.md)."""

import jax
import numpy as np
import pytest

from fluxobs.errors import ModelError
from fluxobs.machines.model.constraint import QuadraticConstraint, invisible_offsets
from fluxobs.research import discover_constraint
from fluxobs.research.analysis import (
    certify_observability,
    excitation,
    gradient_excitation,
    relation_gradients,
)
from fluxobs.research.energies.library import LIBRARY
from fluxobs.research.paper.levitation import MODULATION, SCENARIOS, benchmark, orbit
from fluxobs.research.regression import Parametrisation
from fluxobs.research.regression.periodic import periodic_regression
from support.orbits import random_orbit, smooth
from support.relations import WITHOUT_RELATION

SAMPLES = 512


def rectified(phi, length=1.0):
    """Return the gradient 2ψe(φ) of a machine with magnets."""
    return 2 * np.asarray(length)[..., None] * np.stack([np.cos(phi), np.sin(phi)], axis=-1)


@pytest.mark.parametrize("corner", [0.3, 2.0, 20.0])
@pytest.mark.parametrize("seed", range(4))
def test_excitation_of_the_regressor_lies_between_those_of_the_gradient(seed, corner):
    """ν²ω₁⁴/(ω₁² + ν²)² cov(n) ≤ ⟨Φ_λΦ_λᵀ⟩ ≤ ν² cov(n) over a period."""
    constraint, orbit, gradient, _ = random_orbit(seed, SAMPLES)
    constants = Parametrisation(constraint, "voltage-bias", corner)
    psi = np.asarray(constants.psi_record(periodic_regression(constraint, corner, orbit)))
    filtered = psi[:, :2].T @ psi[:, :2] / SAMPLES
    covariance = np.cov(gradient.T, bias=True)
    weakest = corner**2 / (1 + corner**2) ** 2  # at ω₁ = 1 rad/s
    scale = np.trace(filtered)
    assert np.linalg.eigvalsh(filtered - weakest * covariance)[0] > -1e-9 * scale
    assert np.linalg.eigvalsh(corner**2 * covariance - filtered)[0] > -1e-9 * scale


def test_a_pmsm_is_excited_if_and_only_if_the_rotor_moves_in_every_window():
    h, window = 1e-3, 0.5
    t = np.arange(4000) * h
    swing = 0.02 * np.sin(2 * np.pi * 3 * t)  # one degree
    until = np.minimum(t, 2.0)  # stops after two seconds
    for phi, moves in ((swing, True), (3 * t, True), (until, False), (0 * t + 0.4, False)):
        smallest = gradient_excitation(rectified(phi), h, window).smallest
        assert (smallest.min() > 1e-12) == moves, smallest.min()
    assert gradient_excitation(rectified(until), h, window).smallest[0] > 1e-6


def test_a_window_is_not_excited_by_the_length_of_the_active_flux_alone():
    """A salient machine: i_d changes |n| but not its direction."""
    h = 1e-3
    t = np.arange(1000) * h
    length = 1 + 0.3 * np.sin(20 * t)
    assert gradient_excitation(rectified(0 * t + 0.3, length), h, 0.5).smallest.max() < 1e-12
    # Both together can hide a rotation, but by less than half a turn: ψ_a cos φ is constant.
    phi = np.linspace(-1.2, 1.2, len(t))
    hidden = rectified(phi, 1 / np.cos(phi))
    assert gradient_excitation(hidden, h, 0.999).smallest.max() < 1e-12
    phi = np.linspace(-np.pi / 2, np.pi / 2, len(t))
    for depth in (0.0, 0.5, 0.9):
        seen = rectified(phi, 1 - depth * np.cos(phi) ** 2)  # field weakening in the middle
        assert gradient_excitation(seen, h, 0.999).smallest.min() > 1e-4


def test_ripples_at_rest_excite_a_salient_machine():
    """n = 2 e^{jφ}(ψ_a - jΔL i_q): i_d changes its length, i_q turns it."""
    h, saliency = 1e-3, 0.4
    t = np.arange(1000) * h
    ripple = 0.1 * np.sin(300 * t)

    def gradient(i_d, i_q):
        a = np.exp(0.7j) * (1 + saliency * i_d - 1j * saliency * i_q)
        # The derivative of |x|² - (ψ + ΔL i·x/|x|)² by λ, x = λ - L_q i.
        x = (1 + saliency * i_d) * np.exp(0.7j)
        i = (i_d + 1j * i_q) * np.exp(0.7j)

        def w(x):
            return np.abs(x) ** 2 - (1 + saliency * (i * x.conj()).real / np.abs(x)) ** 2

        step = 1e-6
        slopes = [(w(x + d * step) - w(x - d * step)) / (2 * step) for d in (1, 1j)]
        np.testing.assert_allclose(np.array(slopes), [2 * a.real, 2 * a.imag], atol=1e-7)
        return np.stack(slopes, axis=1)

    assert gradient_excitation(gradient(ripple, 0 * t + 0.3), h, 0.5).smallest.max() < 1e-12
    turned = gradient(0.5 * np.sin(211 * t), ripple)
    assert gradient_excitation(turned, h, 0.5).smallest.min() > 1e-5


def levitation_gradient(flux, position, difference=0.0, gap=1.0):
    """Return (φ₂(g - q), φ₁(g + q)) for φ₁, φ₂ = flux ± difference."""
    return np.stack(
        [(flux - difference) * (gap - position), (flux + difference) * (gap + position)], axis=1
    )


def test_the_levitation_needs_references_of_flux_and_position():
    h = 1e-3
    t = np.arange(2000) * h
    position, flux = 0.3 * np.sin(9 * t), 1 + 0.3 * np.sin(7 * t)

    def smallest(*signals):
        return gradient_excitation(levitation_gradient(*signals), h, 1.5).smallest.max()

    assert smallest(np.ones_like(t), position) < 1e-12
    assert smallest(np.ones_like(t), position, 0.2) < 1e-12  # any constant fluxes
    assert smallest(flux, 0 * t) < 1e-12
    assert smallest(flux, 1 / flux - 0.9) < 1e-12  # φ_d (α + β q_d) constant
    assert smallest(flux, position) > 1e-2
    # The force for the acceleration alone excites with the square of the position.
    force = [smallest(np.ones_like(t), s * position, -1e-3 * s * 81 * position) for s in (1, 0.5)]
    assert force[0] > 1e-7
    assert force[0] / force[1] == pytest.approx(16, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "ratio"), [("S3", 5.8e-6), ("S5", 0.559)])
def test_position_and_flux_reference_predict_the_excitation_of_the_levitation(name, ratio):
    """The difference of the fluxes is that of the force for the acceleration."""
    machine, _ = benchmark()
    trajectory = orbit(name).trajectory
    t, q = trajectory.t[:-1], trajectory.position[:-1, 0]
    flux = trajectory.flux[:-1] / np.array([machine.c_1, machine.c_2])
    phi = machine.k_1 * SCENARIOS[name].bias_current / machine.g
    phi = phi * (1 + SCENARIOS[name].depth * np.sin(MODULATION * t))
    acceleration = np.gradient(np.gradient(q, t), t)
    mass = machine.J / machine.D**2
    difference = mass * machine.k_1 * acceleration / (2 * machine.c_1 * phi)
    predicted = levitation_gradient(phi, q, difference, machine.g)
    actual, _ = relation_gradients([machine.constraint], flux, trajectory.current[:-1])
    ratios = [np.divide(*np.linalg.eigvalsh(np.cov(n.T))) for n in (predicted, actual[:, 0])]
    assert ratios[0] == pytest.approx(ratios[1], rel=0.03)
    assert ratios[0] == pytest.approx(ratio, rel=0.01)


def moving(system, seed, samples=400):
    """Return (flux, current) of a machine on a smooth random motion within its ranges."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 2 * np.pi, samples)
    states = []
    for low, high in (np.asarray(system.flux_range), np.asarray(system.position_range)):
        signal = smooth(rng, t, len(low))
        states.append(low + (high - low) * (0.5 + 0.4 * np.tanh(signal)))
    flux, position = states
    return flux, np.asarray(jax.jit(jax.vmap(system.current))(flux, position))


#: Machines with one and with many relations, with and without invisible directions.
QUICK = {"surface_pmsm", "five_phase_pmsm", "maglev_leakage", "three_coils"}


@pytest.mark.parametrize(
    "make",
    [
        pytest.param(
            make, id=make.__name__, marks=() if make.__name__ in QUICK else pytest.mark.slow
        )
        for make in LIBRARY
        if make.__name__ not in WITHOUT_RELATION
    ],
)
def test_the_certificate_sees_what_the_discovered_relations_see(make):
    system = make()
    relations = discover_constraint(system).relations
    flux, current = moving(system, 3)
    h, window = 1.0, 399.0
    both = certify_observability(
        relations, flux, current, h, window, ("drift", "current-bias"), 1e-13
    )
    # The constraint's own null space, for a trajectory that spans the space.
    assert both.invisible.tolist() == [invisible_offsets(relations).shape[1]]
    assert certify_observability(relations, flux, current, h, window).observable
    # At rest, with constant currents, nothing is seen.
    rest = np.tile(flux[:1], (400, 1)), np.tile(current[:1], (400, 1))
    assert certify_observability(relations, *rest, h, window).smallest.max() < 1e-15


def test_the_weakest_direction_is_that_of_the_invisible_motion():
    """φ = arctan t is invisible: e(φ) is perpendicular to (t, -1)."""
    t = np.linspace(-4, 4, 2001)
    phi = np.arctan(t)
    constraint = QuadraticConstraint(np.eye(2), np.zeros((2, 2)), np.zeros((2, 2)), d=-1.0)
    flux = np.stack([np.cos(phi), np.sin(phi)], axis=1)
    got = certify_observability([constraint], flux, 0 * flux, t[1] - t[0], 8.0)
    assert got.invisible.tolist() == [1]
    size = np.sqrt(np.mean(flux**2, axis=0))
    expected = np.array([0, -1, 4, 0]) / np.r_[size, size]  # the drift's time runs from -1 to 1
    expected /= np.linalg.norm(expected)
    assert abs(got.weakest @ expected) == pytest.approx(1, abs=1e-6)


def test_gradients_are_those_of_the_residual():
    constraint, _, _, _ = random_orbit(5, 32)
    rng = np.random.default_rng(0)
    flux, current = rng.standard_normal((2, 6, 2))
    by_flux, by_current = relation_gradients([constraint], flux, current)
    for port in range(2):
        step = 1e-6 * np.eye(2)[port]
        for values, left, right in (
            (by_flux, (flux + step, current), (flux - step, current)),
            (by_current, (flux, current + step), (flux, current - step)),
        ):
            slope = (constraint.residual(*left) - constraint.residual(*right)) / 2e-6
            np.testing.assert_allclose(values[:, 0, port], slope, rtol=1e-7)


def test_windows_of_the_gradient_agree_with_the_covariance():
    gradient = smooth(np.random.default_rng(1), np.linspace(0, 3, 301), 2)
    got = gradient_excitation(gradient, 0.01, 1.0)
    fine = gradient[100:201]
    weights = np.full(101, 0.01)
    weights[[0, -1]] /= 2
    centred = fine - weights @ fine / weights.sum()
    expected = np.linalg.eigvalsh((centred * weights[:, None]).T @ centred)
    assert got.smallest[100] == pytest.approx(expected[0], rel=1e-9)
    assert got.largest[100] == pytest.approx(expected[1], rel=1e-9)
    # Gradients whose mean is far from zero lose no digits.
    shifted = gradient_excitation(gradient + 1e6, 0.01, 1.0)
    np.testing.assert_allclose(shifted.smallest, got.smallest, rtol=1e-6)
    assert excitation(gradient, 0.01, 1.0).alpha >= got.alpha


def test_bad_arguments_are_named():
    constraint, _, _, _ = random_orbit(5, 32)
    rows = np.ones((10, 2))
    with pytest.raises(ModelError, match=r"\(rows, 2\)"):
        relation_gradients([constraint], rows, np.ones((10, 3)))
    with pytest.raises(ModelError, match="does not fit"):
        certify_observability([constraint], rows, rows, 0.1, 5.0)
    with pytest.raises(ModelError, match="unknowns"):
        certify_observability([constraint], rows, rows, 0.1, 0.5, ("offset",))
