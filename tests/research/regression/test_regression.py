"""Corrected Lemma 1 has small residuals in continuous time and on samples; printed forms fail."""

from functools import cache
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fluxobs import ModelError, QuadraticConstraint
from fluxobs.machines.model.immersion import Immersion
from fluxobs.research.regression import (
    FilteredRegression,
    Parametrisation,
    SampledRegression,
    residual,
)
from fluxobs.research.regression.filtered import filter_record, read_out_record
from support.relations import random_constraint
from support.trajectories import CASES, filtered

VECTORS = Path(__file__).parents[2] / "vectors"


def run_in(rows, first=20):
    """Return the rows after the filters' transient e^{-νt}, with νt > 30."""
    return rows.part(slice(first, None))


CORNERS = {"pmsm": 60.0, "synrm": 60.0, "maglev": 50.0, "three-port": 8.0}


#: Cases in which the integration of the filters needs seconds.
LONG = {"three-port", "pmsm", "synrm"}


@cache
def continuous(name, form="corrected"):
    case, corner = CASES[name](), CORNERS[name]
    times = np.concatenate([np.linspace(0, 40 / corner, 20), np.linspace(42, 60, 60) / corner])
    rows, flux = filtered(case, corner, times, form)
    return case, run_in(rows), flux[20:]


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow if name in LONG else ()) for name in CASES],
)
def test_continuous_regression_is_exact_after_the_transient(name):
    case, rows, flux = continuous(name)
    error = residual(rows, case.constraint, flux, case.drift, case.current_bias)
    assert np.abs(error).max() < 1e-10 * np.sqrt(np.mean(rows.y**2))


@pytest.mark.slow
def test_printed_forms_fail_as_the_errata_state():
    case, rows, flux = continuous("pmsm")
    _, printed_rows, _ = continuous("pmsm", "printed")
    y = np.sqrt(np.mean(rows.y**2))
    # Erratum 2: y_a lacks the factor ν in Φ_λ.
    error = residual(printed_rows, case.constraint, flux, case.drift, case.current_bias)
    assert np.sqrt(np.mean(error**2)) > 0.5 * y
    # The missing term is exactly (ν - 1) y_aᵀλ.
    i_m = np.array([case.measured(t)[1] for t in times_of("pmsm")])
    missing = (CORNERS["pmsm"] - 1) * np.einsum("ki,ki->k", i_m @ case.constraint.Q2.T, flux)
    np.testing.assert_allclose(error, missing, rtol=1e-6, atol=1e-9 * y)
    # Erratum 1: the printed signs of θ_ya and θ_yb are equivalent to a bias of opposite sign.
    error = residual(rows, case.constraint, flux, case.drift, -case.current_bias)
    assert np.sqrt(np.mean(error**2)) > 0.02 * y


def times_of(name):
    return np.linspace(42, 60, 60) / CORNERS[name]


def test_the_constant_of_y_b_has_a_vanishing_regressor():
    """Erratum 4: after ν p²/(p + ν)², only νe^{-νt}(1 - νt) remains of a constant."""
    constraint = QuadraticConstraint(np.eye(2), np.zeros((2, 2)), np.eye(2))
    regression = FilteredRegression(constraint, 5.0)
    steps, h = 2000, 4e-3
    ones = jnp.ones((steps, 3, 2))
    filters = filter_record(regression, h, 0 * ones, ones)
    Phi_b = read_out_record(regression, filters, jnp.ones((steps + 1, 2))).Phi_b
    assert np.abs(Phi_b[0]).max() == pytest.approx(5.0)
    assert np.abs(Phi_b[-1]).max() < 1e-12


@pytest.mark.slow
def test_redundancy_of_the_printed_parametrisation():
    """Erratum 5: Φ_λ = 2 Q1 Φ_a + Q2 Φ_b; therefore (s, -2 Q1 s, -Q2ᵀ s) is never visible."""
    case, rows, _ = continuous("three-port")
    Q1, Q2 = case.constraint.Q1, case.constraint.Q2
    expected = rows.Phi_a @ (2 * Q1) + rows.Phi_b @ Q2.T
    np.testing.assert_allclose(rows.Phi_flux, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["pmsm", "synrm", "maglev", "generic3"])
def test_sampled_recursion_matches_the_sums_in_extended_precision(name):
    vectors = np.load(VECTORS / f"{name}.npz")
    constraint = QuadraticConstraint(vectors["Q1"], vectors["Q2"], vectors["Q3"], C=vectors["C"])
    n = constraint.n
    regression = SampledRegression(
        constraint, float(vectors["corner"]), float(vectors["sample_time"])
    )
    v = np.vstack([np.zeros((1, n)), vectors["volt_seconds"]])
    rows, (m0, m1) = regression.run(v, vectors["measured_current"])
    for field, values in rows._asdict().items():
        expected = vectors[field]
        size = np.sqrt(np.mean(expected**2))
        assert np.abs(values - expected).max() < 1e-8 * size, field
    np.testing.assert_allclose(m0, vectors["m0"], atol=1e-10)
    np.testing.assert_allclose(m1, vectors["m1"], atol=1e-10)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), a=st.floats(0.3, 0.95))
def test_sampled_regression_is_exact_from_the_first_sample(seed, a):
    """It is exact in the transient too, with the start's moments times s, κ of the immersion."""
    rng = np.random.default_rng(seed)
    n, rows_count, h = 3, 30, 0.1
    random = random_constraint(rng, n)
    drift, bias = rng.standard_normal((2, n))
    current = rng.standard_normal((rows_count, n))
    v = rng.standard_normal((rows_count, n))
    flux = np.cumsum(v + h * drift, axis=0)
    # Correct the current along one direction such that the constraint holds at every sample.
    constraint = QuadraticConstraint(
        random.Q1, random.Q2, np.zeros((n, n)), random.E, random.C, 0.7
    )
    slope = constraint.C + flux @ constraint.Q2
    error = constraint.residual(flux, current - bias)
    corrected = current - (error / np.einsum("ki,ki->k", slope, slope))[:, None] * slope
    assert np.abs(constraint.residual(flux, corrected - bias)).max() < 1e-9 * (1 + flux.max() ** 2)
    regression = SampledRegression(constraint, -np.log(a) / h, h)
    rows, (m0, m1) = regression.run(v, corrected)
    plain = QuadraticConstraint(
        constraint.Q1, constraint.Q2, constraint.Q3, C=constraint.C, d=constraint.d
    )
    immersion = Immersion((plain,), ("drift", "current-bias"))
    states = np.array([immersion.lift(x, drift, bias) for x in flux])
    s, kappa = states[:, immersion.slices["s"]][:, 0], states[:, immersion.slices["kappa"]][:, 0]
    error = residual(rows, constraint, flux, drift, bias) - m0 * s + h * m1 * kappa
    size = np.abs(rows.y).max() + np.abs(m0 * s).max() + np.abs(h * m1 * kappa).max()
    assert np.abs(error).max() < 1e-9 * size


@pytest.mark.parametrize("kind", ["printed", "structured"])
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name in LONG else ()) for name in CASES]
)
def test_parametrisations_reproduce_y(name, kind):
    case, rows, flux = continuous(name)
    constants = Parametrisation(case.constraint, kind, CORNERS[name])
    theta = constants.constants(case.drift, case.current_bias)
    assert theta.shape == (len(constants),)
    explained = np.einsum("ki,ki->k", rows.Phi_flux, flux) + constants.record(rows) @ theta
    assert np.abs(explained - rows.y).max() < 1e-9 * np.abs(rows.y).max()


@pytest.mark.slow
def test_voltage_bias_parametrisation_is_exact_without_current_bias():
    case, rows, flux = continuous("pmsm")
    constants = Parametrisation(case.constraint, "voltage-bias", CORNERS["pmsm"])
    assert len(constants) == 3
    # These measurements are also those of the flux λ + L δ without bias (docs/theory.md, section
    # 3).
    shifted = flux + 3e-3 * case.current_bias
    theta = constants.constants(case.drift, np.zeros(2))
    explained = np.einsum("ki,ki->k", rows.Phi_flux, shifted) + constants.record(rows) @ theta
    assert np.abs(explained - rows.y).max() < 1e-9 * np.abs(rows.y).max()


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda c: FilteredRegression(c, 0.0), "corner must be positive"),
        (lambda c: SampledRegression(c, 1.0, -1.0), "sample_time must be positive"),
        (lambda c: Parametrisation(c, "all", 1.0), "parametrisation must be one of printed"),
        (
            lambda c: SampledRegression(c, 1.0, 1.0).run(np.zeros((4, 3)), np.zeros((4, 3))),
            r"must have shape \(rows, 2\)",
        ),
        (
            lambda c: SampledRegression(c, 1.0, 1.0).run(
                np.zeros((4, 2), np.float32), np.zeros((4, 2))
            ),
            "volt_seconds is float32: simulation and research compute in float64 only",
        ),
    ],
)
def test_wrong_arguments(build, message):
    with pytest.raises((ModelError, ValueError), match=message):
        build(QuadraticConstraint(np.eye(2), np.eye(2), np.eye(2)))
