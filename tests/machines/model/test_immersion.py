"""Compare the immersion with the definitions of its states, on random trajectories and machines."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fluxobs import QuadraticConstraint
from fluxobs.machines.model.immersion import Immersion
from support.relations import random_constraint

seeds = st.integers(0, 2**32 - 1)
ports = st.integers(1, 4)
counts = st.integers(1, 3)
unknowns = st.sampled_from([("drift",), ("current-bias",), ("drift", "current-bias")])


def random_immersion(seed, n, r, unknown):
    rng = np.random.default_rng(seed)
    relations = tuple(random_constraint(rng, n) for _ in range(r))
    immersion = Immersion(relations, unknown, rng.standard_normal((n, n)))
    bias = rng.standard_normal(n) if "current-bias" in unknown else np.zeros(n)
    drift = rng.standard_normal(n) if "drift" in unknown else immersion.R @ bias
    return rng, immersion, drift, bias


def lifted(immersion, flux, drift, bias):
    given_drift = drift if "drift" in immersion.unknowns else None
    return immersion.lift(flux, given_drift, bias)


@settings(max_examples=200)
@given(seed=seeds, n=ports, r=counts, unknown=unknowns)
def test_transition_is_exact(seed, n, r, unknown):
    rng, immersion, drift, bias = random_immersion(seed, n, r, unknown)
    flux = rng.standard_normal(n)
    x = lifted(immersion, flux, drift, bias)
    for _ in range(20):
        h, v = rng.uniform(0.01, 0.5), rng.standard_normal(n)
        x = immersion.transition(h, v) @ x + immersion.known_input(v)
        flux = flux + v + h * drift  # exact integral of y_m and the drift
        expected = lifted(immersion, flux, drift, bias)
        size = 1 + np.abs(expected).max() + flux @ flux + drift @ drift
        assert np.abs(x - expected).max() <= 1e-11 * size


@given(seed=seeds, n=ports, r=counts, unknown=unknowns)
def test_the_inverse_is_the_backward_transition(seed, n, r, unknown):
    rng, immersion, _, _ = random_immersion(seed, n, r, unknown)
    h, v = rng.uniform(0.01, 1), rng.standard_normal(n)
    F = immersion.transition(h, v)
    np.testing.assert_array_equal(F, np.triu(F))
    np.testing.assert_array_equal(np.diag(F), 1)
    product = F @ immersion.transition(-h, -v)
    np.testing.assert_allclose(product, np.eye(immersion.size), atol=1e-11)


@given(seed=seeds, n=ports, r=counts, unknown=unknowns)
def test_output_rows_are_the_relations(seed, n, r, unknown):
    rng, immersion, drift, bias = random_immersion(seed, n, r, unknown)
    flux, true_current = rng.standard_normal((2, n))
    rows, values = immersion.output_rows(true_current + bias)
    residual = rows @ lifted(immersion, flux, drift, bias) - values
    expected = [relation.residual(flux, true_current) for relation in immersion.relations]
    np.testing.assert_allclose(residual, expected, rtol=1e-10, atol=1e-10)


@given(seed=seeds, n=ports, r=counts, unknown=unknowns)
def test_row_gain_is_the_derivative_of_the_rows(seed, n, r, unknown):
    rng, immersion, _, _ = random_immersion(seed, n, r, unknown)
    current, step = rng.standard_normal((2, n))
    difference = immersion.output_rows(current + step)[0] - immersion.output_rows(current)[0]
    np.testing.assert_allclose(immersion.row_gain() @ step, difference, atol=1e-12)


def test_the_states_are_those_of_the_c_core():
    immersion = Immersion(QuadraticConstraint(np.eye(2), -np.eye(2), np.eye(2)))
    assert immersion.size == 7
    assert [immersion.slices[name].start for name in ("s", "flux", "kappa", "drift", "c")] == [
        *(0, 1, 3, 4, 6)
    ]


def test_invisible_offsets_depend_on_the_unknowns():
    L = 2e-3
    pmsm = QuadraticConstraint(np.eye(2), -2 * L * np.eye(2), L * L * np.eye(2), d=-0.01)
    both = Immersion(pmsm, ("drift", "current-bias")).invisible()
    np.testing.assert_allclose(both[:2], L * both[2:], atol=1e-12)  # (L s, s)
    assert both.shape == (4, 2)
    assert Immersion(pmsm, ("drift",)).invisible().shape == (4, 0)
    assert Immersion(pmsm, ("current-bias",), 0.4 * np.eye(2)).invisible().shape == (4, 0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"relations": ()}, "at least one"),
        ({"unknowns": ()}, "unknowns must be some of drift, current-bias"),
        ({"unknowns": ("bias",)}, "got bias"),
        ({"unknowns": ("current-bias",)}, "R is missing"),
    ],
)
def test_wrong_arguments_are_refused(change, message):
    relation = QuadraticConstraint(np.eye(2), np.eye(2), np.eye(2))
    with pytest.raises(ValueError, match=message):
        Immersion(**({"relations": (relation,)} | change))


def test_extended_precision_is_kept():
    immersion = Immersion(QuadraticConstraint(np.eye(2), -np.eye(2), np.eye(2)))
    v = np.array([0.1, 0.2], dtype=np.longdouble)
    assert immersion.transition(0.1, v).dtype == np.longdouble
    assert immersion.known_input(v).dtype == np.longdouble
