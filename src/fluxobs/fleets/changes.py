"""One parameter of one drive over time: its level, its trend and its changes.

Each value has its own standard deviation. Values scatter more than their standard deviations, for
example with the ambient temperature; this excess scatter is estimated and added.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..core.arrays import Array

#: Smallest number of values on each side of a change; smallest number for a trend.
LEAST, LEAST_FOR_TREND = 3, 5
#: A trend is significant if its slope exceeds this many standard deviations.
SURE = 4.0
#: Probability of finding a change in a series without a change; it sets :func:`penalty`.
FALSE_ALARM = 0.01
#: Degrees of freedom per value of a median-based variance, relative to a mean of squares.
EFFICIENCY = 0.37


@dataclass(frozen=True)
class Segment:
    """Values `first` to `last`, exclusive, between two changes, with their mean and its std."""

    first: int
    last: int
    mean: float
    std: float


@dataclass(frozen=True)
class Course:
    """Levels, trend and scatter of a series.

    Attributes
    ----------
    segments : tuple of Segment
        At least one segment; one more for each change of the level.
    scatter : float
        Scatter of the values in excess of their standard deviations.
    slope, slope_std : float
        Trend per second over the last segment; with too few values, 0 with infinite std.
    """

    segments: tuple[Segment, ...]
    scatter: float
    slope: float
    slope_std: float

    @property
    def drifts(self) -> bool:
        """Whether the last segment has a significant trend."""
        return abs(self.slope) > SURE * self.slope_std

    @property
    def jumps(self) -> tuple[tuple[int, float, float], ...]:
        """All changes as (index of the first value after the change, size, std of the size)."""
        return tuple(
            (b.first, b.mean - a.mean, float(np.hypot(a.std, b.std)))
            for a, b in pairwise(self.segments)
        )


def course_of(t: Array, values: Array, stds: Array) -> Course:
    """Find segments and trend of a series.

    Parameters
    ----------
    t : (n,) ndarray
        Ascending times [s].
    values, stds : (n,) ndarray
        Finite; stds > 0.
    """
    scatter = scatter_of(t, values, stds)
    variance = stds**2 + scatter**2
    edges = change_points(values, variance)
    if len(edges) > 2 and _is_line(t, values, variance, edges):
        edges = [0, len(values)]
    segments = tuple(_segment(values, variance, first, last) for first, last in pairwise(edges))
    first = edges[-2]
    slope, slope_std = trend(t[first:], values[first:], variance[first:])
    return Course(segments, scatter, slope, slope_std)


def scatter_of(t: Array, values: Array, stds: Array) -> float:
    """Estimate the excess scatter from the median of the squared second differences.

    Levels and trends vanish in second differences; a few jumps hardly move the median.
    """
    n = len(values)
    if n < LEAST_FOR_TREND:
        return 0.0
    # Difference of each inner value from the line through its neighbours.
    span = t[2:] - t[:-2]
    ratio = np.where(span > 0, (t[1:-1] - t[:-2]) / np.where(span > 0, span, 1.0), 0.5)
    differences = values[1:-1] - (1 - ratio) * values[:-2] - ratio * values[2:]
    gain = 1 + (1 - ratio) ** 2 + ratio**2
    variance = stds[1:-1] ** 2 + (1 - ratio) ** 2 * stds[:-2] ** 2 + ratio**2 * stds[2:] ** 2
    # 0.4549 is the median of a squared standard normal number; 1.5 is the smallest gain.
    lower, upper = 0.0, float(np.max(differences**2)) / (1.5 * 0.4549)
    if np.median(differences**2 / variance) <= 0.4549:
        return 0.0
    for _ in range(60):  # bisection: the median falls as the excess variance rises
        excess = (lower + upper) / 2
        if np.median(differences**2 / (variance + gain * excess)) > 0.4549:
            lower = excess
        else:
            upper = excess
    return float(np.sqrt(upper))


def penalty(n: int) -> float:
    """Return the reduction of χ² that a change must bring.

    Chance alone exceeds this penalty in one of a hundred series. The penalty bounds the largest of
    n dependent gains as if the gains were independent. It uses Student's distribution because the
    scatter is itself an estimate (tests/fleets/test_changes.py measures the rate of false alarms).
    """
    from scipy.stats import t

    return float(t.isf(FALSE_ALARM / (2 * max(n, 2)), max(2.0, EFFICIENCY * (n - 2))) ** 2)


def change_points(values: Array, variance: Array) -> list[int]:
    """Return the edges of the segments of constant level that minimise χ² plus penalties.

    The minimum is exact, by dynamic programming over the last change: B. Jackson et al., "An
    algorithm for optimal partitioning of data on an interval", IEEE Signal Processing Letters 12
    (2005), doi:10.1109/LSP.2001.838216.
    """
    n = len(values)
    if n < 2 * LEAST:
        return [0, n]
    w = 1 / variance
    centred = values - np.average(values, weights=w)
    S0, S1, S2 = (np.concatenate([[0.0], np.cumsum(w * centred**k)]) for k in (0, 1, 2))
    cost_of_change = penalty(n)
    best = np.full(n + 1, np.inf)
    best[0] = -cost_of_change
    last_change = np.zeros(n + 1, int)
    for end in range(LEAST, n + 1):
        starts = np.arange(0, end - LEAST + 1)
        weight, moment = S0[end] - S0[starts], S1[end] - S1[starts]
        cost = S2[end] - S2[starts] - moment**2 / weight
        total = best[starts] + cost + cost_of_change
        last_change[end] = starts[np.argmin(total)]
        best[end] = total[last_change[end]]
    edges = [n]
    while edges[-1] > 0:
        edges.append(int(last_change[edges[-1]]))
    return edges[::-1]


def _is_line(t: Array, values: Array, variance: Array, edges: list[int]) -> bool:
    """Return whether a line with one slope fits the values as well as the steps."""
    steps_cost = 0.0
    for first, last in pairwise(edges):
        level = np.average(values[first:last], weights=1 / variance[first:last])
        steps_cost += float(np.sum((values[first:last] - level) ** 2 / variance[first:last]))
    slope, _ = trend(t, values, variance)
    w = 1 / variance
    x, y = t - np.average(t, weights=w), values - np.average(values, weights=w)
    line_cost = float(np.sum(w * (y - slope * x) ** 2))
    cost_of_change = penalty(len(values))
    return line_cost + cost_of_change <= steps_cost + cost_of_change * (len(edges) - 2)


def trend(t: Array, values: Array, variance: Array) -> tuple[float, float]:
    """Return (slope, standard deviation of the slope) of the weighted line."""
    if len(t) < LEAST_FOR_TREND or not np.ptp(t) > 0:
        return 0.0, float("inf")
    w = 1 / variance
    x = t - np.average(t, weights=w)
    curvature = float(np.sum(w * x * x))
    return float(np.sum(w * x * values)) / curvature, float(curvature**-0.5)


def _segment(values: Array, variance: Array, first: int, last: int) -> Segment:
    w = 1 / variance[first:last]
    mean = float(np.average(values[first:last], weights=w))
    return Segment(first, last, mean, float(np.sum(w) ** -0.5))
