"""The integrator of gradient laws and its exponents agree with closed forms and SciPy."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from fluxobs import ModelError, QuadraticConstraint
from fluxobs.research.analysis import (
    floquet_multipliers,
    largest_exponent,
    over_gain,
    weighted_mean,
)
from fluxobs.research.analysis.flow import (
    NODES,
    flow_growth,
    flow_joined,
    flow_product,
    flow_states,
    flow_steps,
)
from fluxobs.research.analysis.stability import balanced_error_system, periodic_nodes, record_nodes
from fluxobs.research.regression import Parametrisation


def at_nodes(signal, start, h, steps):
    times = start + h * (np.arange(steps)[:, None] + NODES)
    return np.array([[signal(t) for t in row] for row in times])


def test_states_against_another_solver_and_their_order():
    """The equation has all terms; the error falls with the fifth power of the step."""
    rng = np.random.default_rng(0)
    N, A, f = 0.3 * rng.standard_normal((4, 4)), rng.standard_normal((4, 3)), rng.standard_normal(4)

    def psi(t):
        return A @ np.array([np.cos(t), np.sin(2 * t), 1.0])

    def r(t):
        return np.sin(3 * t)

    def field(t, x):
        return N @ x + f + psi(t) * (r(t) - psi(t) @ x)

    exact = solve_ivp(field, (0, 4), np.ones(4), method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    errors = []
    for steps in (40, 80):
        h = 4 / steps
        nodes = at_nodes(psi, 0, h, steps), at_nodes(r, 0, h, steps)
        states = flow_states(N, nodes[0], h, np.ones(4), nodes[1], f)
        errors.append(np.abs(states[-1] - exact).max())
    assert errors[1] < 1e-6
    assert errors[0] / errors[1] > 20


def turning(rate, speed, h, steps):
    """Return ψ of rate |ψ|² that turns at constant speed, for which the exponents are known."""
    size = np.sqrt(rate)
    return size * at_nodes(lambda t: [np.cos(speed * t), np.sin(speed * t)], 0, h, steps)


@pytest.mark.parametrize("rate", [30.0, 1e4, 1e8])
def test_exponent_of_a_turning_regressor(rate):
    """In coordinates that turn with ψ, the generator is constant: s² + rate s + ω² = 0."""
    speed, steps = 10.0, 400
    h = 2 * np.pi / speed / steps
    # This form of the slow root avoids cancellation.
    slow = -2 * speed**2 / (rate + np.sqrt(rate**2 - 4 * speed**2))
    P, _ = flow_steps(np.zeros((2, 2)), turning(rate, speed, h, steps), h)
    multiplier = np.abs(floquet_multipliers(P)[0])
    assert np.log(multiplier) / (steps * h) == pytest.approx(slow, rel=1e-5)
    # A record that ends anywhere in a period gives the same exponent.
    longer = 4137
    P, _ = flow_steps(np.zeros((2, 2)), turning(rate, speed, h, longer), h)
    exponent, change = largest_exponent(P, h)
    assert exponent == pytest.approx(slow, rel=1e-4, abs=1e-9)
    assert abs(exponent - slow) < 10 * change + 1e-9


def test_an_unstable_direction_is_found_with_its_sign():
    """With N = diag(0.2, -0.1) and ψ along the second axis, the exponent is exactly 0.2."""
    psi = np.zeros((3000, 3, 2))
    psi[..., 1] = 100.0
    P, _ = flow_steps(np.diag([0.2, -0.1]), psi, 0.01)
    exponent, change = largest_exponent(P, 0.01)
    assert exponent == pytest.approx(0.2, rel=1e-9)
    assert change < 1e-9


def test_products_keep_the_order_of_time():
    rng = np.random.default_rng(1)
    P = np.eye(3) + 0.2 * rng.standard_normal((13, 3, 3))
    product = np.eye(3)
    for step in P:
        product = step @ product
    np.testing.assert_allclose(flow_product(P), product, rtol=1e-12)
    np.testing.assert_allclose(flow_joined(P, 2)[0], P[3] @ P[2] @ P[1] @ P[0], rtol=1e-12)
    assert len(flow_joined(P, 2)) == 3
    x = np.ones(3) / np.sqrt(3)
    assert flow_growth(P).sum() == pytest.approx(np.log(np.linalg.norm(product @ x)))


def test_states_over_more_than_one_block():
    """Without ψ, the step is the exponential of N to the order of the integrator."""
    N, f, h = np.array([[0.0, 1.0], [-1.0, 0.0]]), np.array([1.0, 0.5]), 1e-3
    states = flow_states(N, np.zeros((9000, 3, 2)), h, np.array([1.0, 0.0]), f=f)
    held = expm(9 * N) @ (np.array([1.0, 0.0]) + np.linalg.solve(N, f)) - np.linalg.solve(N, f)
    np.testing.assert_allclose(states[-1], held, rtol=1e-10)


def test_weighted_mean_of_a_quasi_periodic_signal():
    t = 0.1 * np.arange(4000)
    signal = 3 + np.cos(t) + np.cos(np.sqrt(2) * t + 1)
    assert weighted_mean(signal) == pytest.approx(3, abs=1e-7)
    assert abs(signal.mean() - 3) > 1e-3


def test_nodes_of_a_period_and_of_a_record():
    t = 2 * np.pi * np.arange(32) / 32
    psi = np.stack([np.cos(3 * t), np.sin(t)], axis=1)
    exact = at_nodes(lambda t: [np.cos(3 * t), np.sin(t)], 0, 2 * np.pi / 100, 100)
    np.testing.assert_allclose(periodic_nodes(psi, 100), exact, atol=1e-12)
    fine = 0.01 * np.arange(400)
    record = np.stack([np.cos(3 * fine), np.sin(fine)], axis=1)
    exact = at_nodes(lambda t: [np.cos(3 * t), np.sin(t)], 0, 0.005, 798)
    np.testing.assert_allclose(record_nodes(record, 2), exact, atol=1e-7)


CONSTANTS = Parametrisation(
    QuadraticConstraint(np.eye(2), -0.8 * np.eye(2), 0.16 * np.eye(2), d=-1.0), "voltage-bias", 1.0
)


def test_exponents_do_not_depend_on_units():
    """In other units of the constants, γ Γ gives the same law."""
    t = 2 * np.pi * np.arange(256) / 256
    psi = np.stack([np.cos(t), np.sin(t), np.sin(2 * t), np.cos(3 * t), 1 + 0 * t], axis=1)
    units = np.array([1.0, 1.0, 1e-3, 1e-3, 1e6])
    h = 2 * np.pi / 256
    plain = over_gain(psi, h, CONSTANTS, [0.5, 5.0])
    # The relation of flux and drift is unchanged: λ' = θ is λ' = unit · θ_pu.
    scaled = over_gain(psi, h, CONSTANTS, [0.5, 5.0], np.ones(5))
    np.testing.assert_allclose(plain.exponent, scaled.exponent, rtol=1e-9)
    N, root = balanced_error_system(CONSTANTS, units)
    np.testing.assert_allclose(N[:2, 2:4], np.diag(np.sqrt(units[2:4] / units[:2])))
    np.testing.assert_allclose(root @ root.T, np.diag(units))


def test_a_gain_study_calls_stable_only_beyond_its_uncertainty():
    psi = np.zeros((64, 5))
    psi[:, 4] = 1.0  # only the last constant is excited, so all other directions are marginal
    study = over_gain(psi, 0.1, CONSTANTS, [1.0])
    assert abs(study.exponent[0]) < 0.1
    assert study.multipliers(6.4)[0] == pytest.approx(np.exp(6.4 * study.exponent[0]))
    flat = study._replace(exponent=np.array([1e-3]), uncertainty=np.array([2e-3]))
    assert not flat.stable.any()
    assert not flat.unstable.any()
    assert study._replace(exponent=np.array([-1.0]), uncertainty=np.array([0.1])).stable.all()
    assert study._replace(exponent=np.array([1.0]), uncertainty=np.array([0.1])).unstable.all()


@pytest.mark.parametrize(
    ("psi", "message"),
    [
        (np.ones((50, 4)), r"psi must be \(rows, 5\), at least 8 rows, got \(50, 4\)"),
        (np.full((50, 5), np.nan), "psi is not finite at row 0"),
        (np.linspace(0, 1, 50)[:, None] * np.ones(5), "not periodic: at the end of the period"),
    ],
)
def test_wrong_regressors(psi, message):
    with pytest.raises(ModelError, match=message):
        over_gain(jnp.asarray(psi), 0.1, CONSTANTS, [1.0])
