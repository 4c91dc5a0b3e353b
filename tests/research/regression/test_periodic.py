"""The regression in periodic steady state agrees with its residual and the filters over time."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fluxobs import ModelError
from fluxobs.machines.model.constraint import QuadraticConstraint
from fluxobs.research.regression import (
    FilteredRegression,
    Orbit,
    Parametrisation,
    between,
    periodic_regression,
    residual,
)
from fluxobs.research.regression.filtered import filter_record, read_out_record

CORNER, PERIOD = 3.0, 2 * np.pi
L, PSI = 0.4, 1.0
RELATION = QuadraticConstraint(np.eye(2), -2 * L * np.eye(2), L * L * np.eye(2), d=-(PSI**2))
DRIFT, BIAS = np.array([0.05, -0.1]), np.array([0.02, 0.03])


def signals(t):
    """Return signals of a PMSM whose angle and current have the period 2π."""
    angle = t + 0.8 * jnp.sin(t)
    axis = jnp.array([jnp.cos(angle), jnp.sin(angle)])
    current = jnp.array([0.3 * jnp.sin(2 * t), 0.5 + 0.2 * jnp.cos(t)])
    return L * current + PSI * axis, current


def sampled(t):
    def measured(t):
        (flux, current), (rate, _) = jax.jvp(signals, (t,), (jnp.ones_like(t),))
        return flux, rate - DRIFT, current + BIAS

    return (np.asarray(values) for values in jax.jit(jax.vmap(measured))(jnp.asarray(t)))


def test_the_regression_holds_to_rounding():
    t = PERIOD * np.arange(256) / 256
    flux, y_m, current = sampled(t)
    rows = periodic_regression(RELATION, CORNER, Orbit(PERIOD, y_m, current))
    error = np.asarray(residual(rows, RELATION, flux, DRIFT, BIAS))
    assert np.abs(error).max() < 1e-12 * np.abs(rows.y).max()


def test_the_constants_of_a_voltage_bias_explain_it():
    """These measurements are also those of the flux λ + L δ without a bias of the current."""
    flux, y_m, current = sampled(PERIOD * np.arange(256) / 256)
    rows = periodic_regression(RELATION, CORNER, Orbit(PERIOD, y_m, current))
    constants = Parametrisation(RELATION, "voltage-bias", CORNER)
    assert len(constants) == 3
    theta = constants.constants(DRIFT, np.zeros(2))
    explained = np.einsum("ki,ki->k", rows.Phi_flux, flux + L * BIAS)
    explained += constants.record(rows) @ theta
    assert np.abs(explained - rows.y).max() < 1e-12 * np.abs(rows.y).max()


def test_the_filters_converge_to_it():
    per_period, periods = 512, 4
    half = PERIOD / per_period / 2
    fine = half * np.arange(2 * per_period * periods + 1)
    _, y_m, current = sampled(fine)
    steps = 2 * np.arange(per_period * periods)[:, None] + np.arange(3)
    regression = FilteredRegression(RELATION, CORNER)
    filters = filter_record(
        regression, 2 * half, jnp.asarray(y_m[steps]), jnp.asarray(current[steps])
    )
    rows = read_out_record(regression, filters, jnp.asarray(current[::2]))
    steady = periodic_regression(
        RELATION, CORNER, Orbit(PERIOD, y_m[: 2 * per_period : 2], current[: 2 * per_period : 2])
    )
    for name, values in steady._asdict().items():
        late = np.asarray(getattr(rows, name))[-per_period - 1 : -1]
        np.testing.assert_allclose(values, late, atol=1e-7 * np.abs(late).max(), err_msg=name)


@pytest.mark.parametrize("samples", [16, 17])
def test_between_is_exact_for_resolved_signals(samples):
    def exact(t):
        return np.stack([1 + np.cos(3 * t), np.sin(7 * t)], axis=1)

    values = between(exact(2 * np.pi * np.arange(samples) / samples), 50, 0.3)
    np.testing.assert_allclose(values, exact(2 * np.pi * (np.arange(50) + 0.3) / 50), atol=1e-12)


def test_too_few_samples_are_refused():
    t = PERIOD * np.arange(16) / 16
    _, y_m, current = sampled(t)
    with pytest.raises(ModelError, match="y_m: 16 samples per period do not resolve"):
        periodic_regression(RELATION, CORNER, Orbit(PERIOD, y_m, current))
    # Units have no effect: resolution does not depend on the size of the signals.
    for unit in (1e-6, 1e6):
        with pytest.raises(ModelError, match="16 samples per period do not resolve"):
            periodic_regression(RELATION, CORNER, Orbit(PERIOD, unit * y_m, unit * current))
    _, fine, fine_current = sampled(PERIOD * np.arange(256) / 256)
    for unit in (1e-6, 1e6):
        periodic_regression(RELATION, CORNER, Orbit(PERIOD, unit * fine, unit * fine_current))
    # A wrong period also raises an error.
    t = 0.9 * PERIOD * np.arange(256) / 256
    _, y_m, current = sampled(t)
    with pytest.raises(ModelError, match="check that the period is"):
        periodic_regression(RELATION, CORNER, Orbit(0.9 * PERIOD, y_m, current))
