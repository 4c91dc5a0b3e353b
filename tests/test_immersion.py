"""The immersion against the definitions of its states, on random trajectories and machines."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fluxobs import QuadraticConstraint
from fluxobs.immersion import known_input, lift, output_row, transition

seeds = st.integers(0, 2**32 - 1)
ports = st.integers(1, 4)


def random_constraint(rng, n):
    Q1, Q2, Q3 = rng.standard_normal((3, n, n))
    E, C = rng.standard_normal((2, n))
    return QuadraticConstraint(Q1, Q2, Q3, E, C, d=rng.standard_normal())


@settings(max_examples=200)
@given(seed=seeds, n=ports)
def test_transition_is_exact(seed, n):
    rng = np.random.default_rng(seed)
    constraint = random_constraint(rng, n)
    flux, drift = rng.standard_normal((2, n))
    x = lift(constraint, flux, drift)
    for _ in range(20):
        h, v = rng.uniform(0.01, 0.5), rng.standard_normal(n)
        x = transition(constraint, h, v) @ x + known_input(constraint, v)
        flux = flux + v + h * drift  # exact: y_m and the drift are integrated
        expected = lift(constraint, flux, drift)
        assert np.abs(x - expected).max() <= 1e-12 * (1 + np.abs(expected).max() + flux @ flux)


@given(seed=seeds, n=ports)
def test_inverse_is_the_transition_backwards(seed, n):
    rng = np.random.default_rng(seed)
    constraint = random_constraint(rng, n)
    h, v = rng.uniform(0.01, 1), rng.standard_normal(n)
    F = transition(constraint, h, v)
    np.testing.assert_array_equal(F, np.triu(F))
    np.testing.assert_array_equal(np.diag(F), 1)
    product = F @ transition(constraint, -h, -v)
    np.testing.assert_allclose(product, np.eye(2 * n + 3), atol=1e-12)


@given(seed=seeds, n=ports)
def test_output_row_is_the_constraint(seed, n):
    rng = np.random.default_rng(seed)
    constraint = random_constraint(rng, n)
    flux, drift, i = rng.standard_normal((3, n))
    row, value = output_row(constraint, i)
    residual = row @ lift(constraint, flux, drift) - value
    assert residual == pytest.approx(constraint.residual(flux, i), rel=1e-11, abs=1e-11)


def test_extended_precision_passes_through():
    constraint = QuadraticConstraint(np.eye(2), -np.eye(2), np.eye(2))
    v = np.array([0.1, 0.2], dtype=np.longdouble)
    assert transition(constraint, 0.1, v).dtype == np.longdouble
    assert known_input(constraint, v).dtype == np.longdouble
