"""Inertia, friction and load from a known motion."""

import numpy as np
import pytest

from fluxobs.errors import FluxobsError
from fluxobs.identification.mechanics import (
    OVERLAP,
    SEGMENT,
    Friction,
    cut,
    identify_mechanics,
    inertia,
)

J, VISCOUS, COULOMB = 1e-3, 1e-3, 0.05
H, DURATION = 1e-4, 2.5


def driven(seed, load=1.0, stiffness=None):
    """Return t, angle, torque and load of a drive under speed control; the load steps."""
    rng = np.random.default_rng(seed)
    rows, substeps = round(DURATION / H), 8
    t = H * np.arange(rows)
    turns, steps = np.cumsum(rng.uniform(0.3, 0.9, (2, 8)), axis=1)
    speeds, loads = rng.uniform(-200, 200, 9), load * np.r_[0, rng.uniform(-1, 1, 8)]
    applied = loads[np.searchsorted(steps, t)]
    wanted = speeds[np.searchsorted(turns, t)]
    theta, torque = np.zeros(rows), np.zeros(rows)
    angle = speed = reference = integrator = 0.0
    far_angle = far_speed = 0.0  # of the inertia behind an elastic shaft
    own = J if stiffness is None else J / 2
    for k in range(rows):
        reference += np.clip(wanted[k] - reference, -500 * H, 500 * H)
        integrator += H * 50**2 * J * (reference - speed)
        theta[k], torque[k] = angle, 100 * J * (reference - speed) + integrator
        for _ in range(substeps):
            friction = VISCOUS * speed + COULOMB * np.tanh(speed / 0.2)
            shaft = 0.0
            if stiffness is not None:
                shaft = stiffness * (angle - far_angle) + 2e-3 * (speed - far_speed)
                far_speed += H / substeps * (shaft - applied[k]) / (J / 2)
                far_angle += H / substeps * far_speed
            rest = shaft if stiffness is not None else applied[k]
            speed += H / substeps * (torque[k] - friction - rest) / own
            angle += H / substeps * speed
    return t, theta + 1e-4 * rng.standard_normal(rows), torque, applied


def identified(t, theta, torque, std=1e-9, noise=0.01, valid=None, load_std=np.inf):
    rng = np.random.default_rng(0)
    measured = torque + noise * rng.standard_normal(len(t))
    valid = np.ones(len(t), bool) if valid is None else valid
    return identify_mechanics(t, theta, measured, std * np.abs(torque) + 1e-12, valid, load_std)


@pytest.mark.parametrize("seed", [0, 2, 3])
def test_without_load_everything_is_known(seed):
    t, theta, torque, _ = driven(seed, load=0.0)
    found = identified(t, theta, torque)
    for name, true in (("J", J), ("viscous", VISCOUS), ("coulomb", COULOMB)):
        assert found.identifies(name)
        assert found.values[name] == pytest.approx(true, rel=0.03)
        assert abs(found.values[name] - true) < 3 * found.stds[name]
    assert np.abs(found.load).max() < 0.02
    assert abs(found.elastic) < 3


def test_without_reversal_a_constant_load_looks_like_dry_friction():
    t, theta, torque, _ = driven(1, load=0.0)
    assert not identified(t, theta, torque).identifies("coulomb")
    found = identified(t, theta, torque, load_std=0.0)
    assert found.values["coulomb"] == pytest.approx(COULOMB, rel=0.03)
    assert np.abs(found.load).max() < 1e-4


@pytest.mark.parametrize("seed", range(4))
def test_steps_of_the_load_leave_the_inertia_and_open_the_friction(seed):
    t, theta, torque, load = driven(seed)
    found = identified(t, theta, torque)
    assert found.values["J"] == pytest.approx(J, rel=0.02)
    assert abs(found.values["J"] - J) < 3 * found.stds["J"]
    for name, true in (("viscous", VISCOUS), ("coulomb", COULOMB)):
        assert abs(found.values[name] - true) < 3 * found.stds[name]
    # Far from its steps, the load is that of the segment within its standard deviation.
    within = np.abs(found.load - np.interp(found.t, t, load)) < 3 * found.load_std
    assert within.mean() > 0.75


def test_the_scale_of_the_torque_is_in_every_standard_deviation():
    t, theta, torque, _ = driven(0, load=0.0)
    exact, scaled = identified(t, theta, torque), identified(t, theta, torque, std=0.04)
    for name, value in scaled.values.items():
        expected = np.hypot(exact.stds[name], 0.04 * value)
        assert scaled.stds[name] > 0.98 * expected
    assert scaled.stds["J"] < 1.6 * 0.04 * J


def test_a_drag_passes_for_friction():
    """Iron loss of 3 % of the largest torque at the largest speed."""
    t, theta, torque, _ = driven(0, load=0.0)
    speed = np.gradient(theta, t)
    drag = 0.03 * np.abs(torque).max() * speed / np.abs(speed).max()
    valid = np.ones(len(t), bool)
    found = identify_mechanics(t, theta, torque + drag, np.abs(drag), valid)
    error = found.values["viscous"] - VISCOUS
    assert error > 0.1 * VISCOUS
    assert error < 2 * found.stds["viscous"]


def test_the_noise_of_the_torque_does_not_bias_the_inertia():
    t, theta, torque, _ = driven(1, load=0.0)
    noisy = torque + 0.5 * np.random.default_rng(1).standard_normal(len(t))
    valid = np.ones(len(t), bool)
    value, std = inertia(cut(t, theta, noisy, valid, SEGMENT, OVERLAP), OVERLAP)
    assert abs(value - J) < 3 * std
    assert std < 0.1 * J


def test_an_elastic_shaft_is_named():
    """Resonance at 14 Hz: short segments see the motor alone, long ones both inertias."""
    t, theta, torque, _ = driven(2, load=0.3, stiffness=2.0)
    assert abs(identified(t, theta, torque).elastic) > 3


def test_rows_that_are_not_valid_are_not_used():
    t, theta, torque, _ = driven(3, load=0.0)
    valid = (t < 0.6) | (t > 0.9)
    spoilt = np.where(valid, theta, 1e3)
    found = identified(t, spoilt, np.where(valid, torque, np.nan), valid=valid)
    assert found.values["J"] == pytest.approx(J, rel=0.03)


def test_lost_samples_are_bridged():
    t, theta, torque, _ = driven(3, load=0.0)
    valid = np.random.default_rng(1).random(len(t)) > 0.01
    found = identified(
        t, np.where(valid, theta, np.nan), np.where(valid, torque, np.nan), valid=valid
    )
    assert found.values["J"] == pytest.approx(J, rel=0.03)


def test_too_few_rows():
    t, theta, torque, _ = driven(0)
    valid = t < 0.2
    with pytest.raises(FluxobsError, match=r"segments of 0\.0992 s: the mechanics need 5"):
        identified(t, theta, torque, valid=valid)


def test_a_constant_speed_tells_no_inertia():
    t = H * np.arange(20000)
    with pytest.raises(FluxobsError, match="the torque hardly changes"):
        identified(t, 100 * t, np.full(len(t), 0.3))


def test_the_load_is_the_least_squares_solution():
    """Against dense linear algebra, for fixed variances and weights."""
    t, theta, torque, _ = driven(2)
    segments = cut(t, theta, torque, np.ones(len(t), bool), SEGMENT, 1)
    problem = Friction(segments, J, 1e-5)
    rng = np.random.default_rng(5)
    logs, n = np.log([3e-4, 2e-4]), len(problem.torque)
    weights = rng.uniform(0.1, 1.0, n - 1)
    noise, step = problem.size**2 * np.exp(logs)
    difference = np.diff(np.eye(n), axis=0)
    rows = np.vstack(
        [
            np.hstack([np.eye(n), problem.regressors]) / np.sqrt(noise),
            np.hstack([difference * np.sqrt(weights / step)[:, None], np.zeros((n - 1, 3))]),
            np.hstack([np.eye(n) / (10 * problem.size), np.zeros((n, 3))]),
            np.hstack([np.zeros((3, n)), np.diag(np.sqrt(problem.prior))]),
        ]
    )
    right = np.concatenate([problem.torque / np.sqrt(noise), np.zeros(2 * n + 2)])
    solution, *_ = np.linalg.lstsq(rows, right, rcond=None)
    covariance = np.linalg.inv(rows.T @ rows)
    found = problem._state(logs, weights)
    np.testing.assert_allclose(found.load, solution[:n], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.parameters, solution[n:], rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(found.covariance, covariance[n:, n:], rtol=1e-5, atol=1e-18)
    np.testing.assert_allclose(found.load_std**2, np.diag(covariance)[:n], rtol=1e-5)
