"""The smoother agrees with conditioning the joint Gaussian of all blocks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fluxobs.errors import ModelError
from fluxobs.smoothing.smoother import STATES, Blocks, smooth

COUNT, MEASURED, SIDES = 25, 2, 4
MISSING = ([3, 4, 12, 12, 20], [0, 0, 0, 1, 1])  # blocks, measurements


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def drawn_blocks(rng) -> Blocks:
    variance = 10.0 ** rng.uniform(-3, 1, (COUNT, MEASURED))
    variance[MISSING] = np.inf
    return Blocks(
        rng.uniform(0.1, 2.0, COUNT),
        rng.standard_normal((COUNT, 2)),
        rng.uniform(0.5, 1.0, COUNT),
        10.0 ** rng.uniform(-4, 0, (COUNT, 4)),
        rng.standard_normal((COUNT, MEASURED, STATES)),
        variance,
    )


def transition(blocks: Blocks, k: int) -> np.ndarray:
    F = np.eye(STATES)
    F[0, 2] = F[1, 3] = blocks.duration[k]
    F[:2, 5] = blocks.coupling[k]
    F[4, 4] = blocks.decay[k]
    return F


def joint_covariance(blocks: Blocks, start: np.ndarray) -> np.ndarray:
    """Return the covariance of all states, (blocks * 6, blocks * 6), before any measurement."""
    to_noise = [np.eye(STATES, STATES * COUNT)]  # each state as a sum of start and process noises
    for k in range(1, COUNT):
        row = transition(blocks, k) @ to_noise[-1]
        row[:, STATES * k : STATES * (k + 1)] += np.eye(STATES)
        to_noise.append(row)
    noise = np.concatenate([start, blocks.walk[1:, [0, 0, 1, 1, 2, 3]].ravel()])
    A = np.concatenate(to_noise)
    return A @ np.diag(noise) @ A.T


@pytest.mark.parametrize("start", [np.ones(STATES), np.array([4.0, 4.0, 0.1, 0.1, 0.0, 0.0])])
def test_against_the_joint_gaussian(rng, start):
    blocks = drawn_blocks(rng)
    y = rng.standard_normal((COUNT, MEASURED, SIDES))
    smoothed = smooth(blocks, y, start)
    prior = joint_covariance(blocks, start)
    measured = np.isfinite(blocks.variance)
    H = np.zeros((measured.sum(), STATES * COUNT))
    for n, (k, m) in enumerate(np.argwhere(measured)):
        H[n, STATES * k : STATES * (k + 1)] = blocks.row[k, m]
    S = H @ prior @ H.T + np.diag(blocks.variance[measured])
    gain = np.linalg.solve(S, H @ prior).T
    state = (gain @ y[measured]).reshape(COUNT, STATES, SIDES)
    covariance = prior - gain @ H @ prior
    assert smoothed.state == pytest.approx(state, rel=1e-8, abs=1e-8)
    for k in range(COUNT):
        own = slice(STATES * k, STATES * (k + 1))
        assert smoothed.covariance[k] == pytest.approx(covariance[own, own], rel=1e-7, abs=1e-8)
    # Innovations and their variances factor the density of the measurements.
    e, s = smoothed.innovation[measured], smoothed.variance[measured]
    assert np.log(s).sum() == pytest.approx(np.linalg.slogdet(S)[1])
    products = y[measured].T @ np.linalg.solve(S, y[measured])
    assert (e / s[:, None]).T @ e == pytest.approx(products)
    assert not smoothed.innovation[~measured].any()
    assert np.isinf(smoothed.variance[~measured]).all()


def test_blocks_with_one_measurement(rng):
    """A second measurement that is missing everywhere changes nothing."""
    both, start = drawn_blocks(rng), np.ones(STATES)
    y = rng.standard_normal((COUNT, MEASURED, SIDES))
    both.variance[:, 1] = np.inf
    alone = replace(both, row=both.row[:, :1], variance=both.variance[:, :1])
    expected, smoothed = smooth(both, y, start), smooth(alone, y[:, :1], start)
    np.testing.assert_array_equal(smoothed.state, expected.state)
    np.testing.assert_array_equal(smoothed.innovation, expected.innovation[:, :1])


def test_a_right_hand_side_does_not_depend_on_the_others(rng):
    blocks, start = drawn_blocks(rng), np.ones(STATES)
    y = rng.standard_normal((COUNT, MEASURED, SIDES))
    together, alone = smooth(blocks, y, start), smooth(blocks, y[:, :, 2:3], start)
    np.testing.assert_array_equal(together.state[:, :, 2], alone.state[:, :, 0])
    np.testing.assert_array_equal(together.covariance, alone.covariance)


def test_what_is_not_measured_may_hold_anything(rng):
    blocks, start = drawn_blocks(rng), np.ones(STATES)
    y = rng.standard_normal((COUNT, MEASURED, SIDES))
    expected = smooth(blocks, y, start)
    y[MISSING] = np.nan
    np.testing.assert_array_equal(smooth(blocks, y, start).state, expected.state)


def test_bad_input(rng):
    blocks, start = drawn_blocks(rng), np.ones(STATES)
    y = rng.standard_normal((COUNT, MEASURED, SIDES))
    with pytest.raises(ModelError, match="measurements of shape"):
        smooth(blocks, y[1:], start)
    with pytest.raises(ModelError, match="6 variances"):
        smooth(blocks, y, start[1:])
    y[0, 0, 0] = np.nan
    with pytest.raises(ModelError, match="measurement of the smoother is not finite"):
        smooth(blocks, y, start)
    blocks.variance[5] = 0.0
    with pytest.raises(ModelError, match="positive variances"):
        smooth(blocks, np.nan_to_num(y), start)
