"""Changes and trends are found at the right place, with the stated rate of false alarms."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
import pytest
from scipy import optimize, stats

from fluxobs.fleets.changes import (
    FALSE_ALARM,
    LEAST,
    Course,
    _is_line,
    _segment,
    change_points,
    course_of,
    penalty,
    scatter_of,
    trend,
)

DAY = 86400.0


def brute_force(values, variance):
    """Return the best division of a short series, by trying all divisions."""
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
def test_segments_equal_a_brute_force_search(seed):
    rng = np.random.default_rng(seed)
    values = rng.standard_normal(14) + 6 * (np.arange(14) > rng.integers(2, 12))
    variance = rng.uniform(0.3, 3.0, 14)
    assert change_points(values, variance) == brute_force(values, variance)


@pytest.mark.parametrize("n", [8, 30, 100])
def test_false_alarms_are_within_their_rate(n):
    rng, alarms, trends = np.random.default_rng(n), 0, 0
    for _ in range(300):
        t = np.sort(rng.uniform(0, 300 * DAY, n))
        stds = 0.01 * rng.uniform(0.5, 2.0, n)
        values = 1 + stds * rng.standard_normal(n) + 0.02 * rng.standard_normal(n)
        course = course_of(t, values, stds)
        alarms += len(course.segments) > 1
        trends += course.drifts
    assert alarms <= 300 * FALSE_ALARM + 5  # + three standard deviations
    assert trends <= 5


def test_scatter_is_found_beside_jumps_and_trends():
    rng = np.random.default_rng(5)
    t, stds = np.sort(rng.uniform(0, 1, 400)), np.full(400, 0.01)
    values = 0.03 * rng.standard_normal(400) + 0.01 * rng.standard_normal(400)
    for change in (0.0, 3 * t, 1.0 * (t > 0.3)):
        assert scatter_of(t, values + change, stds) == pytest.approx(0.03, rel=0.2)
    assert scatter_of(t, 0.01 * rng.standard_normal(400), stds) < 0.008


def test_a_jump_is_found_with_its_size():
    rng = np.random.default_rng(6)
    values = 1 + 0.01 * rng.standard_normal(60)
    values[40:] += 0.05
    course = course_of(np.arange(60) * DAY, values, np.full(60, 0.01))
    ((first, change, std),) = course.jumps
    assert first == 40
    assert change == pytest.approx(0.05, abs=4 * std)
    assert not course.drifts


def test_a_trend_is_not_fitted_by_steps():
    rng = np.random.default_rng(7)
    t = np.arange(60) * DAY
    course = course_of(t, 1 + 0.01 * rng.standard_normal(60) + t * 2e-8, np.full(60, 0.01))
    assert len(course.segments) == 1
    assert course.drifts
    assert course.slope == pytest.approx(2e-8, abs=4 * course.slope_std)


def test_slope_and_std_equal_weighted_least_squares():
    rng = np.random.default_rng(8)
    t, variance = np.sort(rng.random(20)), rng.uniform(0.5, 2.0, 20)
    values = rng.standard_normal(20)
    A = np.stack([np.ones(20), t], axis=1)
    P = np.linalg.inv(A.T @ (A / variance[:, None]))
    slope, std = trend(t, values, variance)
    assert slope == pytest.approx((P @ A.T @ (values / variance))[1])
    assert std == pytest.approx(np.sqrt(P[1, 1]))


@pytest.mark.parametrize("n", [1, 2, 4])
def test_few_values_have_only_a_level(n):
    course = course_of(np.arange(n) * DAY, np.arange(n, dtype=float), np.full(n, 0.1))
    assert len(course.segments) == 1
    assert course.jumps == ()
    assert not course.drifts


def test_logs_of_the_same_time_have_no_trend():
    course = course_of(np.zeros(10), np.linspace(0, 1, 10), np.full(10, 0.3))
    assert course.slope == 0.0


def scatter_by_root_finding(t, values, stds):
    """Return the scatter at which normalised second differences have the median of χ²(1)."""
    triples = []
    for k in range(1, len(t) - 1):
        share = (t[k] - t[k - 1]) / (t[k + 1] - t[k - 1])
        weights = np.array([share - 1, 1.0, -share])
        triples.append((weights @ values[k - 1 : k + 2], weights**2 @ stds[k - 1 : k + 2] ** 2))
        triples[-1] += (weights @ weights,)
    differences, variances, gain = np.array(triples).T

    def excess(variance):
        return np.median(differences**2 / (variances + gain * variance)) - stats.chi2(1).median()

    return np.sqrt(optimize.brentq(excess, 0.0, 100.0, xtol=1e-14))


@pytest.mark.parametrize("n", [5, 6, 41])
def test_scatter_follows_from_the_median_of_second_differences(n):
    rng = np.random.default_rng(n)
    t, stds = np.cumsum(rng.uniform(0.2, 3.0, n)), rng.uniform(0.1, 0.3, n)
    values = 2 * t + rng.standard_normal(n)
    assert scatter_of(t, values, stds) == pytest.approx(
        scatter_by_root_finding(t, values, stds), rel=2e-4
    )


def test_equal_times_compare_a_value_with_the_mean_of_its_neighbours():
    values = np.array([0.0, 2.0, 1.0, 4.0, 0.0, 1.0])
    assert scatter_of(np.zeros(6), values, np.full(6, 0.1)) == pytest.approx(
        scatter_by_root_finding(np.arange(6.0), values, np.full(6, 0.1)), rel=2e-4
    )


def test_scatter_and_trend_need_five_values():
    values = np.array([0.0, 3.0, 1.0, 5.0, 2.0])
    t, stds = np.arange(5.0), np.full(5, 0.1)
    assert scatter_of(t, values, stds) > 1.0
    assert scatter_of(t[:4], values[:4], stds[:4]) == 0.0
    assert trend(t, t, stds**2)[0] == pytest.approx(1.0)
    assert trend(t[:4], t[:4], stds[:4] ** 2) == (0.0, np.inf)


def test_second_differences_as_large_as_their_stds_are_no_scatter():
    """In a zigzag of ±a, the second difference is 2a and its variance is 1.5 std²."""
    a = np.sqrt(stats.chi2(1).median() * 1.5) / 2
    zigzag = a * (-1.0) ** np.arange(9)
    assert scatter_of(np.arange(9.0), 0.999 * zigzag, np.ones(9)) == 0.0
    scatter = scatter_of(np.arange(9.0), 1.1 * zigzag, np.ones(9))
    assert scatter == pytest.approx(np.sqrt(1.1**2 - 1), rel=1e-3)


@pytest.mark.parametrize("n", [8, 30, 100])
def test_the_penalty_has_a_false_alarm_rate_of_one_percent(n):
    """The penalty is two-sided Student's t for n places, with 0.37 n degrees of freedom.

    0.37 is the efficiency of the median absolute deviation.
    """
    freedom = max(2.0, 0.37 * (n - 2))
    assert 2 * n * stats.t(freedom).sf(np.sqrt(penalty(n))) == pytest.approx(0.01)


def test_the_shortest_series_have_a_penalty():
    assert penalty(0) == penalty(2)
    assert 4 * stats.t(2).sf(np.sqrt(penalty(2))) == pytest.approx(0.01)
    assert penalty(3) > penalty(2)


def test_a_change_needs_three_values_on_each_side():
    step = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
    assert change_points(step, np.full(6, 1e-6)) == [0, 3, 6]
    assert change_points(step[1:], np.full(5, 1e-6)) == [0, 5]


@pytest.mark.parametrize(("factor", "edges"), [(0.99, [0, 12]), (1.01, [0, 6, 12])])
def test_a_change_must_exceed_its_penalty(factor, edges):
    """A step of d between two halves of n/2 values gains n d²/4."""
    step = factor * np.sqrt(4 * penalty(12) / 12)
    assert change_points(step * (np.arange(12) >= 6), np.ones(12)) == edges


def test_two_changes_cost_two_penalties():
    """Three levels 0, d, 0 of 6 values each gain 4 d² by two changes."""
    values = np.repeat([0.0, 1.0, 0.0], 6)
    step = np.sqrt(2 * penalty(18) / 4)
    assert change_points(0.99 * step * values, np.ones(18)) == [0, 18]
    assert change_points(1.01 * step * values, np.ones(18)) == [0, 6, 12, 18]


def test_a_line_replaces_steps_that_fit_no_better():
    t = np.arange(12.0)
    variance = np.linspace(0.5, 2.0, 12)
    for noise in np.linspace(0.0, 4.0, 9):
        values = t + noise * np.where(t < 6, -1.0, 1.0)
        edges = [0, 6, 12]
        w = np.sqrt(1 / variance)
        line = np.polynomial.Polynomial.fit(t, values, 1, w=w)
        line_cost = np.sum((w * (values - line(t))) ** 2)
        steps_cost = sum(
            np.sum((w[k] * (values[k] - np.average(values[k], weights=w[k] ** 2))) ** 2)
            for k in (slice(0, 6), slice(6, 12))
        )
        assert _is_line(t, values, variance, edges) == (line_cost <= steps_cost)


def test_each_step_of_a_staircase_costs_a_penalty():
    """A line is chosen if it fits at most two penalties worse than three steps."""
    t = np.arange(16.0)
    values = np.repeat([0.0, 1.0, 2.0, 3.0], 4)
    line = np.polynomial.Polynomial.fit(t, values, 1)
    line_cost = np.sum((values - line(t)) ** 2)
    for factor, is_line in ((0.99, True), (1.01, False)):
        scale = factor * np.sqrt(2 * penalty(16) / line_cost)
        assert _is_line(t, scale * values, np.ones(16), [0, 4, 8, 12, 16]) == is_line


def test_a_trend_counts_above_four_deviations():
    for slope, drifts in ((3.9, False), (4.1, True), (-3.9, False), (-4.1, True)):
        assert Course((), 0.0, slope, 1.0).drifts == drifts


def test_levels_and_jumps_have_the_std_of_weighted_means():
    values = np.array([1.0, 2.0, 4.0, 41.0, 42.0, 44.0])
    stds = np.array([1.0, 2.0, 1.0, 2.0, 2.0, 1.0]) * 0.5
    first, second = (_segment(values, stds**2, *edges) for edges in ((0, 3), (3, 6)))
    assert first.mean == pytest.approx((1 + 2 / 4 + 4) / 2.25)
    assert first.std == pytest.approx(0.5 / np.sqrt(2.25))
    assert second.std == pytest.approx(0.5 / np.sqrt(1.5))
    ((index, change, std),) = Course((first, second), 0.0, 0.0, 1.0).jumps
    assert index == 3
    assert change == pytest.approx(second.mean - first.mean)
    assert std == pytest.approx(0.5 * np.sqrt(1 / 2.25 + 1 / 1.5))


def test_the_trend_covers_the_last_segment():
    t = np.arange(16.0)
    values = np.where(t < 8, 0.1 * (-1) ** t, 50.0 + 0.2 * t)
    course = course_of(t, values, np.full(16, 1.0))
    assert [segment.last for segment in course.segments] == [8, 16]
    assert course.slope == pytest.approx(0.2)
    assert course.slope_std == pytest.approx(1 / np.sqrt(42.0))


def test_the_scatter_widens_the_stds():
    rng = np.random.default_rng(9)
    t, values, stds = np.arange(30.0), rng.standard_normal(30), np.full(30, 0.4)
    course = course_of(t, values, stds)
    assert course.scatter == scatter_of(t, values, stds) > 0.5
    assert course.segments[0].std == pytest.approx(np.hypot(0.4, course.scatter) / np.sqrt(30))
