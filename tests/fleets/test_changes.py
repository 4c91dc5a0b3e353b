"""Changes and trends: found where they are, and nowhere else more often than promised."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
import pytest

from fluxobs.fleets.changes import (
    FALSE_ALARM,
    LEAST,
    change_points,
    course_of,
    penalty,
    scatter_of,
    trend,
)

DAY = 86400.0


def brute_force(values, variance):
    """All ways to divide a short series."""
    n, best = len(values), (np.inf, None)
    for count in range(n // LEAST):
        for inner in combinations(range(LEAST, n - LEAST + 1), count):
            edges = [0, *inner, n]
            if min(b - a for a, b in pairwise(edges)) < LEAST:
                continue
            cost = count * penalty(n)
            for a, b in pairwise(edges):
                level = np.average(values[a:b], weights=1 / variance[a:b])
                cost += np.sum((values[a:b] - level) ** 2 / variance[a:b])
            best = min(best, (cost, edges))
    return best[1]


@pytest.mark.parametrize("seed", range(8))
def test_segments_are_the_best_of_all(seed):
    rng = np.random.default_rng(seed)
    values = rng.standard_normal(14) + 6 * (np.arange(14) > rng.integers(2, 12))
    variance = rng.uniform(0.3, 3.0, 14)
    assert change_points(values, variance) == brute_force(values, variance)


@pytest.mark.parametrize("n", [8, 30, 100])
def test_false_alarms_are_rarer_than_promised(n):
    rng, alarms, trends = np.random.default_rng(n), 0, 0
    for _ in range(300):
        t = np.sort(rng.uniform(0, 300 * DAY, n))
        stds = 0.01 * rng.uniform(0.5, 2.0, n)
        values = 1 + stds * rng.standard_normal(n) + 0.02 * rng.standard_normal(n)
        found = course_of(t, values, stds)
        alarms += len(found.segments) > 1
        trends += found.drifts
    assert alarms <= 300 * FALSE_ALARM + 5  # three standard deviations of chance
    assert trends <= 5


def test_scatter_is_found_beside_jumps_and_trends():
    rng = np.random.default_rng(5)
    t, stds = np.sort(rng.uniform(0, 1, 400)), np.full(400, 0.01)
    values = 0.03 * rng.standard_normal(400) + 0.01 * rng.standard_normal(400)
    for more in (0.0, 3 * t, 1.0 * (t > 0.3)):
        assert scatter_of(t, values + more, stds) == pytest.approx(0.03, rel=0.2)
    assert scatter_of(t, 0.01 * rng.standard_normal(400), stds) < 0.008


def test_a_jump_is_found_with_its_size():
    rng = np.random.default_rng(6)
    values = 1 + 0.01 * rng.standard_normal(60)
    values[40:] += 0.05
    found = course_of(np.arange(60) * DAY, values, np.full(60, 0.01))
    ((first, by, std),) = found.jumps
    assert first == 40
    assert by == pytest.approx(0.05, abs=4 * std)
    assert not found.drifts


def test_a_trend_is_no_staircase():
    rng = np.random.default_rng(7)
    t = np.arange(60) * DAY
    found = course_of(t, 1 + 0.01 * rng.standard_normal(60) + t * 2e-8, np.full(60, 0.01))
    assert len(found.segments) == 1
    assert found.drifts
    assert found.slope == pytest.approx(2e-8, abs=4 * found.slope_std)


def test_slope_and_its_std_are_those_of_weighted_least_squares():
    rng = np.random.default_rng(8)
    t, variance = np.sort(rng.random(20)), rng.uniform(0.5, 2.0, 20)
    values = rng.standard_normal(20)
    A = np.stack([np.ones(20), t], axis=1)
    P = np.linalg.inv(A.T @ (A / variance[:, None]))
    slope, std = trend(t, values, variance)
    assert slope == pytest.approx((P @ A.T @ (values / variance))[1])
    assert std == pytest.approx(np.sqrt(P[1, 1]))


@pytest.mark.parametrize("n", [1, 2, 4])
def test_few_values_have_a_level_and_no_more(n):
    found = course_of(np.arange(n) * DAY, np.arange(n, dtype=float), np.full(n, 0.1))
    assert len(found.segments) == 1
    assert found.jumps == ()
    assert not found.drifts


def test_all_logs_of_one_moment():
    found = course_of(np.zeros(10), np.linspace(0, 1, 10), np.full(10, 0.3))
    assert found.slope == 0.0
