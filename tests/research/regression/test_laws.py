"""The paper's observers and related observers agree with their definitions."""

from functools import cache

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fluxobs import ModelError, QuadraticConstraint
from fluxobs.research.analysis import balanced_basis, balanced_gain, observability_gramian
from fluxobs.research.paper.pmsm import servo
from fluxobs.research.regression import Parametrisation, Regressors
from fluxobs.research.regression.laws import (
    PEBO,
    DremObserver,
    GeneralisedPEBO,
    PrintedAdaptiveObserver,
    RepairedAdaptiveObserver,
    RiccatiObserver,
    RobustObserver,
    VoltageModel,
    flow_gain,
    run,
)
from support.trajectories import pmsm

RELATION = QuadraticConstraint(np.eye(2), -0.8 * np.eye(2), 0.16 * np.eye(2), d=-1.0)
CONSTANTS = Parametrisation(RELATION, "voltage-bias", 1.0)


@eqx.filter_jit
def compiled_step(observer, *arguments):
    return observer.step(*arguments)


def step(observer, state, h, v, row):
    return compiled_step(observer, state, jnp.asarray(h), v, row)  # a float would be static


@jax.jit
def regressor(row):
    return CONSTANTS.regressor(row)


def random_row(rng, n=2):
    vectors = [jnp.asarray(rng.standard_normal(n)) for _ in range(4)]
    return Regressors(jnp.asarray(rng.standard_normal()), *vectors, jnp.asarray(2.0))


def observers(rng):
    A = rng.standard_normal((5, 5))
    return {
        "robust": RobustObserver([1.0, 2.0], 2),
        "adaptive": PrintedAdaptiveObserver(A @ A.T + np.eye(5), CONSTANTS),
        "repaired": RepairedAdaptiveObserver([1.0, 2.0], [0.5, 1.0, 3.0], CONSTANTS),
        "voltage model": VoltageModel(2),
    }


@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_short_step_follows_the_differential_equation(seed):
    """(step(h) - state)/h converges to `derivative` for every law published as an equation."""
    rng = np.random.default_rng(seed)
    row, y_m = random_row(rng), jnp.asarray(rng.standard_normal(2))
    for name, observer in observers(rng).items():
        state = jax.tree.map(
            lambda leaf: jnp.asarray(rng.standard_normal(leaf.shape)), observer.init()
        )
        rate = observer.derivative(state, y_m, row)
        errors = []
        for h in (1e-4, 1e-5):
            moved = step(observer, state, h, h * y_m, row)
            change = jax.tree.map(lambda a, b, h=h: (a - b) / h, moved, state)
            pairs = zip(jax.tree.leaves(change), jax.tree.leaves(rate), strict=True)
            errors.append(max(float(jnp.abs(a - b).max()) for a, b in pairs))
        assert errors[1] < 0.2 * errors[0] + 1e-8, name


def test_a_step_is_the_exact_flow_of_a_constant_regressor():
    """This holds at any gain, so stiff laws need no small steps."""
    row = random_row(np.random.default_rng(0))._replace(Phi_flux=jnp.array([0.6, -0.8]))
    observer, start, h = RobustObserver([30.0, 40.0], 2), jnp.array([1.0, 2.0]), 0.3
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, x, _: observer.derivative(x, jnp.zeros(2), row)),
        diffrax.Dopri8(),
        0.0,
        h,
        1e-4,
        start,
        stepsize_controller=diffrax.PIDController(rtol=1e-11, atol=1e-12),
    )
    np.testing.assert_allclose(
        step(observer, start, h, jnp.zeros(2), row), solution.ys[0], rtol=1e-8
    )
    huge = step(RobustObserver(1e20, 2), start, h, jnp.zeros(2), row)
    assert float(abs(row.y - row.Phi_flux @ huge)) < 1e-10
    assert float(flow_gain(jnp.asarray(0.0), 0.3)) == 0.3


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_repaired_error_is_a_cascade(seed):
    """η = λ̃ - U θ̃ obeys η' = -Γ Φ Φᵀ η for any θ̃ and G, and exactly in steps."""
    rng = np.random.default_rng(seed)
    observer = observers(rng)["repaired"]
    flux, theta = rng.standard_normal(2), rng.standard_normal(3)
    state = observer.init()._replace(
        flux=jnp.asarray(rng.standard_normal(2)), constants=jnp.asarray(rng.standard_normal(3))
    )
    eta = (
        np.asarray(state.flux) - flux - np.asarray(state.U) @ (np.asarray(state.constants) - theta)
    )
    h = 0.2
    for _ in range(10):
        row, v = random_row(rng), rng.standard_normal(2)
        flux = flux + v + h * theta[:2]
        y = row.Phi_flux @ flux + regressor(row) @ theta
        row = row._replace(y=y)
        state = step(observer, state, h, jnp.asarray(v), row)
        direction = observer.Gamma @ row.Phi_flux
        gain = flow_gain(row.Phi_flux @ direction, h)
        eta = eta - np.asarray(gain * direction) * float(row.Phi_flux @ eta)
        error = np.asarray(state.constants) - theta
        eta_estimate = np.asarray(state.flux) - flux - np.asarray(state.U) @ error
        np.testing.assert_allclose(
            eta_estimate, eta, atol=1e-9 * (1 + np.abs(np.asarray(state.U)).max())
        )


@cache
def record():
    return servo(quick=True)


def record_and_skip():
    drive = record()
    return drive, jnp.asarray(drive.volt_seconds), round(15 / 200 / drive.h)


def errors(flux):
    """Return errors of the active flux λ - L i over ψ, which do not depend on the current bias."""
    drive = record()
    shift = drive.machine.L_s * drive.current_bias
    return np.linalg.norm(np.asarray(flux) - drive.flux - shift, axis=1) / drive.machine.psi_f


def test_pebo_with_a_gradient_equals_proposition_1():
    drive, v, skip = record_and_skip()
    Gamma = balanced_gain(np.asarray(drive.rows.Phi_flux)[skip:], 50.0)
    pebo, _ = run(PEBO(2, "gradient", Gamma), drive.h, v, drive.rows, skip)
    robust, _ = run(RobustObserver(Gamma, 2), drive.h, v, drive.rows, skip)
    np.testing.assert_allclose(pebo, robust, atol=1e-9 * np.abs(drive.flux).max())


def test_open_loop_integration_and_least_squares_pebo_drift():
    drive, v, skip = record_and_skip()
    drifting, _ = run(VoltageModel(2), drive.h, v, drive.rows, skip)
    k = np.searchsorted(drive.t, [0.5, 0.9])
    growth = np.linalg.norm(
        np.asarray(drifting)[k[1]]
        - np.asarray(drifting)[k[0]]
        - drive.flux[k[1]]
        + drive.flux[k[0]]
    )
    assert growth == pytest.approx(0.4 * np.linalg.norm(drive.drift[0]), rel=1e-3)
    estimates, _ = run(PEBO(2), drive.h, v, drive.rows, skip)
    assert errors(estimates)[k[1]] > 1.3 * errors(estimates)[np.searchsorted(drive.t, 0.3)]


def test_which_adaptive_observers_converge():
    drive, v, skip = record_and_skip()
    constants = Parametrisation(drive.constraint, "voltage-bias", 200.0)
    psi = np.column_stack([drive.rows.Phi_flux, constants.record(drive.rows)])[skip:]
    printed, _ = run(
        PrintedAdaptiveObserver(balanced_gain(psi, 100.0), constants), drive.h, v, drive.rows, skip
    )
    assert errors(printed)[drive.t > 0.9].min() > 1.0
    half = len(drive.t) // 2
    window = 0.2
    before = drive.rows.part(slice(skip, half))
    size = np.r_[0.0125, 0.0125, 0.05, 0.05, 2 / 200 * 0.05**2]
    gramian = observability_gramian(before, constants, drive.h, window, size)
    basis = size[:, None] * balanced_basis(gramian, window)
    for observer in (
        DremObserver(100.0, 0.05, basis, constants),
        RiccatiObserver(0.05, size, 1e-3 * 0.0125, constants),
    ):
        estimates, theta = run(observer, drive.h, v, drive.rows, skip)
        late = (drive.t > 0.7) & (drive.t < drive.t[half])
        assert errors(estimates)[late].max() < 1e-5, type(observer).__name__
        np.testing.assert_allclose(np.asarray(theta)[half - 1][:2], drive.drift[0], rtol=1e-3)


def test_riccati_equals_the_dense_weighted_least_squares():
    rng = np.random.default_rng(5)
    observer = RiccatiObserver(0.3, [1.0, 1.0, 0.5, 0.5, 2.0], 0.1, CONSTANTS)
    h, state = 0.05, observer.init()
    rows = [np.diag(1 / np.asarray(observer.scale))]
    values = [np.zeros(5)]
    back = np.eye(5)
    back[:2, 2:4] = -h * np.eye(2)
    fade = np.exp(-h / 0.6)
    for _ in range(40):
        row, v = random_row(rng), rng.standard_normal(2)
        state = step(observer, state, h, jnp.asarray(v), row)
        moved = np.vstack(rows) @ back
        values = [fade * (np.concatenate(values) + moved[:, :2] @ v)]
        rows = [fade * moved]
        psi = np.r_[row.Phi_flux, regressor(row)]
        rows.append(np.sqrt(h) / 0.1 * psi[None])
        values.append(np.sqrt(h) / 0.1 * np.atleast_1d(row.y))
    expected = np.linalg.lstsq(np.vstack(rows), np.concatenate(values), rcond=None)[0]
    estimates = np.concatenate(observer.estimate(state))
    np.testing.assert_allclose(estimates, expected, rtol=1e-9)


@pytest.mark.slow
def test_drem_is_exact_once_its_formula_applies():
    """In finite time, when 1 - w > 0.1, the estimate is exact up to rounding."""
    rng = np.random.default_rng(2)
    theta = np.array([0.2, -0.1, 0.3])
    observer = DremObserver(1.0, 1.0, np.eye(5), CONSTANTS)
    flux, h, state, largest_errors = np.array([0.5, -0.4]), 0.05, observer.init(), []
    for _ in range(400):
        row, v = random_row(rng), 0.1 * rng.standard_normal(2)
        flux = flux + v + h * theta[:2]
        row = row._replace(y=row.Phi_flux @ flux + regressor(row) @ theta)
        state = step(observer, state, h, jnp.asarray(v), row)
        if 1 - float(state.start_weight) > 0.1:
            estimates, constants = observer.estimate(state)
            error = max(np.abs(estimates - flux).max(), np.abs(constants - theta).max())
            largest_errors.append(error)
    assert 0 < len(largest_errors) < 400
    assert max(largest_errors) < 1e-8


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: RobustObserver(-1.0, 2), "Gamma must be positive definite"),
        (lambda: RobustObserver([[1.0, 2.0], [2.0, 1.0]], 2), "smallest eigenvalue -1"),
        (lambda: RobustObserver([[1.0, 0.5], [0.0, 1.0]], 2), "Gamma must be symmetric"),
        (lambda: PrintedAdaptiveObserver([1.0, 2.0], CONSTANTS), r"Gamma must be a number, \(5,\)"),
        (lambda: RepairedAdaptiveObserver(1.0, 0.0, CONSTANTS), "G must be positive definite"),
        (lambda: RobustObserver(np.float32(1.0), 2), "Gamma is float32"),
        (lambda: RobustObserver(np.nan, 2), "Gamma must be finite"),
        (lambda: RiccatiObserver(0.0, np.ones(5), 1.0, CONSTANTS), "memory must be positive"),
        (lambda: DremObserver(1.0, 1.0, np.ones(4), CONSTANTS), r"basis must be \(5,\)"),
        (lambda: DremObserver(1.0, 1.0, np.ones(5), CONSTANTS, 0.0), "finite must lie in"),
        (lambda: PEBO(2, "median"), "estimator must be least-squares or gradient"),
    ],
)
def test_wrong_arguments(build, message):
    with pytest.raises((ModelError, ValueError), match=message):
        build()


def test_gains_of_very_different_units_are_positive_definite():
    PrintedAdaptiveObserver([1e20, 1e20, 1e20, 1e20, 20.0], CONSTANTS)


def test_parametrisation_lengths():
    case = pmsm()
    assert [
        len(Parametrisation(case.constraint, kind, 1.0))
        for kind in ("printed", "structured", "voltage-bias")
    ] == [7, 5, 3]


def test_generalised_pebo_equals_the_dense_least_squares():
    """The dense problem expresses all rows in the initial state, with forgetting and the prior."""
    rng = np.random.default_rng(4)
    scale, beta, h = np.array([1.0, 1.0, 0.5, 0.5, 2.0]), 0.7, 0.05
    observer = GeneralisedPEBO(CONSTANTS, scale, 0.1, forgetting=beta)
    state, xi = observer.init(), np.zeros(2)
    rows, values = [np.diag(1 / scale)], [np.zeros(5)]
    for k in range(1, 31):
        row, v = random_row(rng), rng.standard_normal(2)
        state = step(observer, state, h, jnp.asarray(v), row)
        xi = xi + v
        psi = np.r_[row.Phi_flux, regressor(row)]
        psi[2:4] += k * h * psi[:2]
        information = np.vstack(rows) * scale
        uncertainty = min(1.0, 1 / np.linalg.eigvalsh(information.T @ information)[0])
        fade = np.exp(-beta * (1 - uncertainty) * h / 2)
        rows = [fade * earlier for earlier in rows] + [np.sqrt(h) / 0.1 * psi[None]]
        value = float(row.y - row.Phi_flux @ xi)
        values = [fade * earlier for earlier in values] + [np.sqrt(h) / 0.1 * np.atleast_1d(value)]
    start = np.linalg.lstsq(np.vstack(rows), np.concatenate(values), rcond=None)[0]
    flux, constants = observer.estimate(state)
    np.testing.assert_allclose(constants, start[2:], rtol=1e-9)
    np.testing.assert_allclose(flux, xi + start[:2] + 30 * h * start[2:4], rtol=1e-9)


def test_mixed_estimates_follow_their_equation():
    """``θ̂_j' = γ Δ (Y_j - Δ θ̂_j)`` holds with the mixed regression constant over a step."""
    rng = np.random.default_rng(9)
    gamma, h, size = 3.0, 0.05, 5
    observer = GeneralisedPEBO(
        CONSTANTS, np.ones(size), 1.0, "least-squares-drem", forgetting=0.1, gamma=gamma
    )
    state = observer.init()
    for _ in range(20):
        before = np.asarray(state.mixed)
        v = jnp.asarray(rng.standard_normal(2))
        state = step(observer, state, h, v, random_row(rng))
        share = np.eye(size) - float(state.start_weight) * np.linalg.inv(state.M)
        delta, start = np.linalg.det(share), np.linalg.solve(state.M, state.m)
        Y = [
            np.linalg.det(np.column_stack([*share.T[:j], start, *share.T[j + 1 :]]))
            for j in range(size)
        ]
        rate = gamma * delta**2
        exact = before * np.exp(-rate * h)
        if delta > 1e-6:
            exact = exact - np.expm1(-rate * h) * np.array(Y) / delta
        np.testing.assert_allclose(state.mixed, exact, rtol=1e-6, atol=1e-9)


def test_mixing_removes_the_initial_value_from_the_least_squares():
    """With interval excitation, least squares keeps a part of its start value; mixing does not."""
    rng = np.random.default_rng(6)
    theta = np.array([0.2, -0.1, 0.3])
    observers = {
        name: GeneralisedPEBO(CONSTANTS, np.ones(5), 1.0, name, 0.1, 50.0)
        for name in ("least-squares", "least-squares-drem")
    }
    states = {name: observer.init() for name, observer in observers.items()}
    flux, h = np.array([0.5, -0.4]), 0.05
    for k in range(300):
        row, v = random_row(rng), 0.1 * rng.standard_normal(2)
        if k >= 60:  # excitation has ended
            row = Regressors(*(0 * entry for entry in row))
        flux = flux + v + h * theta[:2]
        row = row._replace(y=row.Phi_flux @ flux + regressor(row) @ theta)
        for name, observer in observers.items():
            states[name] = step(observer, states[name], h, jnp.asarray(v), row)
    errors = {
        name: np.abs(np.asarray(observers[name].estimate(state)[0]) - flux).max()
        for name, state in states.items()
    }
    assert errors["least-squares"] > 1e-2
    assert errors["least-squares-drem"] < 1e-6


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"estimator": "median"}, "estimator must be one of least-squares, least-squares-drem"),
        ({"forgetting": -1.0}, "forgetting must be zero or positive"),
        ({"scale": np.ones(4)}, "scale must have shape"),
    ],
)
def test_wrong_arguments_of_generalised_pebo(change, message):
    with pytest.raises(ModelError, match=message):
        GeneralisedPEBO(**({"constants": CONSTANTS, "scale": np.ones(5), "noise": 1.0} | change))
