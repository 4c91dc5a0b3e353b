"""Proposition 2 at small and large gain: both sides of Theorems 3 and 4 (docs/theorems.md)."""

import numpy as np
import pytest

from fluxobs.errors import ModelError
from fluxobs.machines.model.constraint import QuadraticConstraint
from fluxobs.research.analysis import large_gain_sum, over_gain, small_gain_rates
from fluxobs.research.analysis.flow import flow_product, flow_steps
from fluxobs.research.analysis.stability import balanced_error_system, periodic_nodes
from fluxobs.research.paper.pmsm import counter_example
from fluxobs.research.regression import Parametrisation
from fluxobs.research.regression.periodic import Orbit, periodic_regression
from support.orbits import random_orbit

SAMPLES = 512
CORNER = 2.0


def gradient_spectrum(gradient, t):
    """Return (ω, coefficients) of a periodic gradient of the relation, without its mean."""
    count = len(t)
    coefficients = np.fft.fft(gradient, axis=0) / count
    omega = 2 * np.pi * np.fft.fftfreq(count, t[1] - t[0])
    return omega[1:], coefficients[1:]


@pytest.mark.parametrize("seed", range(4))
def test_the_drift_regressor_is_the_flux_regressor_delayed(seed):
    """⟨Φ_mΦ_λᵀ⟩ + its transpose is -2 Σ τ |G|² n̂n̂*, with the group delay τ of G = νp²/(p + ν)²."""
    constraint, orbit, gradient, t = random_orbit(seed, SAMPLES)
    constants = Parametrisation(constraint, "voltage-bias", CORNER)
    psi = np.asarray(constants.psi_record(periodic_regression(constraint, CORNER, orbit)))
    X = psi[:, 2:4].T @ psi[:, :2] / len(psi)
    omega, coefficients = gradient_spectrum(gradient, t)
    power = CORNER**2 * omega**4 / (omega**2 + CORNER**2) ** 2
    delay = 2 * CORNER / (omega**2 + CORNER**2)
    expected = -2 * np.einsum("k,ki,kj->ij", delay * power, coefficients, coefficients.conj()).real
    np.testing.assert_allclose(X + X.T, expected, rtol=1e-9, atol=1e-12 * np.abs(X).max())
    assert np.linalg.eigvalsh(X + X.T)[-1] < 0


@pytest.mark.parametrize("seed", range(4))
def test_small_gains_are_unstable_for_any_relation_and_block_gain(seed):
    constraint, orbit, _, _ = random_orbit(seed, SAMPLES)
    constants = Parametrisation(constraint, "voltage-bias", CORNER)
    psi = np.asarray(constants.psi_record(periodic_regression(constraint, CORNER, orbit)))
    rng = np.random.default_rng(seed + 100)
    Gamma = np.zeros((5, 5))
    for block in (slice(0, 2), slice(2, 4), slice(4, 5)):
        root = rng.standard_normal((block.stop - block.start,) * 2)
        Gamma[block, block] = root @ root.T + 0.2 * np.eye(block.stop - block.start)
    rates = small_gain_rates(psi, constants, Gamma)
    assert (rates.real > 0).all()
    assert (np.abs(rates.imag) < rates.real).all()
    gains = 1e-6 / rates[0].real ** 2 * np.array([0.25, 1.0])
    study = over_gain(psi, 2 * np.pi / SAMPLES, constants, gains, Gamma)
    half, whole = study.exponent / np.sqrt(gains)
    # The next term is proportional to √γ.
    assert 2 * half - whole == pytest.approx(rates[0].real, rel=1e-3)


def test_the_small_gain_rate_of_a_pmsm_at_constant_speed_is_that_of_the_closed_form():
    """n = 2ψe(ωt): ⟨Φ_mΦ_λᵀ⟩ = 2ψ²|G|² (-τ I + κ J), with κ = d ln|G|/dω."""
    speed, magnet = 3.0, 1.5
    t = np.arange(SAMPLES) * 2 * np.pi / speed / SAMPLES
    e = np.stack([np.cos(speed * t), np.sin(speed * t)], axis=1)
    constraint = QuadraticConstraint(Q1=np.eye(2), Q2=np.zeros((2, 2)), Q3=np.zeros((2, 2)))
    rate = magnet * speed * np.stack([-e[:, 1], e[:, 0]], axis=1)
    rows = periodic_regression(constraint, CORNER, Orbit(2 * np.pi / speed, rate, 0 * rate))
    constants = Parametrisation(constraint, "voltage-bias", CORNER)
    psi = np.asarray(constants.psi_record(rows))
    power = CORNER**2 * speed**4 / (speed**2 + CORNER**2) ** 2
    delay = 2 * CORNER / (speed**2 + CORNER**2)
    slope = 2 / speed - 2 * speed / (speed**2 + CORNER**2)
    expected = np.sqrt(2 * magnet**2 * power * (delay + 1j * slope))
    rates = small_gain_rates(psi, constants)
    np.testing.assert_allclose(rates.real, expected.real, rtol=1e-9)
    np.testing.assert_allclose(np.abs(rates.imag), expected.imag, rtol=1e-9)


def test_a_gradient_that_is_constant_has_no_small_gain_instability():
    psi = np.tile([0.0, 0.0, 0.3, 0.2, 1.0], (64, 1))
    constraint = QuadraticConstraint(Q1=np.eye(2), Q2=np.zeros((2, 2)), Q3=np.zeros((2, 2)))
    constants = Parametrisation(constraint, "voltage-bias", 1.0)
    np.testing.assert_array_equal(small_gain_rates(psi, constants), 0)


def finite_exponents(psi, h, constants, gain, Gamma):
    """Return the sum of all exponents but the fastest, from the transition over a period."""
    N, root = balanced_error_system(constants, Gamma)
    period = h * len(psi)
    steps = 4 * len(psi)
    P, _ = flow_steps(N, periodic_nodes(np.sqrt(gain) * psi @ root, steps), period / steps)
    values = np.sort(np.abs(np.linalg.eigvals(flow_product(P))))
    return float(np.log(values[1:]).sum()) / period


@pytest.mark.parametrize("shape", [1.0, [1.0, 1.0, 0.2, 0.7, 3.0]])
def test_the_finite_exponents_at_large_gain_have_the_sum_of_the_closed_form(shape):
    orbit = counter_example(1024)
    constants = Parametrisation(orbit.constraint, "voltage-bias", 1.0)
    psi = np.asarray(constants.psi_record(orbit.rows))
    expected = large_gain_sum(psi, constants, shape)
    sums = [finite_exponents(psi, orbit.h, constants, gain, shape) for gain in (1e3, 1e4)]
    assert expected > 0.02
    assert abs(sums[1] - expected) < 2e-3 * expected
    assert abs(sums[1] - expected) < abs(sums[0] - expected)
    study = over_gain(psi, orbit.h, constants, (1e3, 1e5), shape)
    assert (study.exponent > expected / 4).all()  # the largest of four


def test_bad_regressors_are_named():
    constraint = QuadraticConstraint(Q1=np.eye(2), Q2=np.zeros((2, 2)), Q3=np.zeros((2, 2)))
    constants = Parametrisation(constraint, "voltage-bias", 1.0)
    with pytest.raises(ModelError, match=r"\(rows, 5\)"):
        small_gain_rates(np.ones((4, 3)), constants)
    with pytest.raises(ModelError, match="row 2"):
        large_gain_sum(np.array([[1.0] * 5, [1.0] * 5, [0.0] * 5]), constants)
