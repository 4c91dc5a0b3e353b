"""One parameter of one drive over time: its level, its trend, and where it changed.

Every value has a standard deviation of its own. Values scatter by more than these, with the
temperature of the day for example: what they scatter by besides is estimated and added.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..core.arrays import Array

#: Fewest values on each side of a change, and fewest for a trend.
LEAST, LEAST_FOR_TREND = 3, 5
#: A trend counts if its slope is this many standard deviations from zero.
SURE = 4.0
#: Chance that a series in which nothing changes shows a change: sets :func:`penalty`.
FALSE_ALARM = 0.01
#: Degrees of freedom that a value adds to an estimate by a median, where the mean of squares has 1.
EFFICIENCY = 0.37


@dataclass(frozen=True)
class Segment:
    """Values between two changes: the first and last (exclusive), their mean, and its std."""

    first: int
    last: int
    mean: float
    std: float


@dataclass(frozen=True)
class Course:
    """What a series did.

    Attributes
    ----------
    segments : tuple of Segment
        At least one; more if the level changed.
    scatter : float
        What the values scatter by besides their standard deviations.
    slope, slope_std : float
        Per second, over the last segment; 0 and infinite with too few values.
    """

    segments: tuple[Segment, ...]
    scatter: float
    slope: float
    slope_std: float

    @property
    def drifts(self) -> bool:
        """Whether there is a trend."""
        return abs(self.slope) > SURE * self.slope_std

    @property
    def jumps(self) -> tuple[tuple[int, float, float], ...]:
        """Every change: the first value after it, by how much, and the std of that."""
        return tuple(
            (b.first, b.mean - a.mean, float(np.hypot(a.std, b.std)))
            for a, b in pairwise(self.segments)
        )


def course_of(t: Array, values: Array, stds: Array) -> Course:
    """Segments and trend of a series.

    Parameters
    ----------
    t : (n,) ndarray
        Times, rising [s].
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
    """Excess scatter: what makes second differences, in which levels and trends vanish, as large as
    they are; by their median, which a few jumps do not move."""
    n = len(values)
    if n < LEAST_FOR_TREND:
        return 0.0
    # Each inner value against the line through its neighbours.
    span = t[2:] - t[:-2]
    share = np.where(span > 0, (t[1:-1] - t[:-2]) / np.where(span > 0, span, 1.0), 0.5)
    off = values[1:-1] - (1 - share) * values[:-2] - share * values[2:]
    gain = 1 + (1 - share) ** 2 + share**2
    known = stds[1:-1] ** 2 + (1 - share) ** 2 * stds[:-2] ** 2 + share**2 * stds[2:] ** 2
    # The median of a squared standard normal number is 0.4549; no gain is below 1.5.
    low, high = 0.0, float(np.max(off**2)) / (1.5 * 0.4549)
    if np.median(off**2 / known) <= 0.4549:
        return 0.0
    for _ in range(60):  # what makes the median right: bisection, it falls with the scatter
        middle = (low + high) / 2
        if np.median(off**2 / (known + gain * middle)) > 0.4549:
            low = middle
        else:
            high = middle
    return float(np.sqrt(high))


def penalty(n: int) -> float:
    """Gain in χ² that a change must bring: what chance exceeds once in a hundred series.

    The largest of n dependent gains, bounded as if they were independent; Student's distribution,
    because the scatter is itself an estimate (tests/fleets/test_changes.py measures the chance).
    """
    from scipy.stats import t

    return float(t.isf(FALSE_ALARM / (2 * max(n, 2)), max(2.0, EFFICIENCY * (n - 2))) ** 2)


def change_points(values: Array, variance: Array) -> list[int]:
    """Edges of the segments of constant level that minimise χ² plus a penalty for each change.

    Exact, by dynamic programming over the last change: B. Jackson et al., "An algorithm for optimal
    partitioning of data on an interval", IEEE Signal Processing Letters 12 (2005),
    doi:10.1109/LSP.2001.838216.
    """
    n = len(values)
    if n < 2 * LEAST:
        return [0, n]
    w = 1 / variance
    centred = values - np.average(values, weights=w)
    S0, S1, S2 = (np.concatenate([[0.0], np.cumsum(w * centred**k)]) for k in (0, 1, 2))
    each = penalty(n)
    best = np.full(n + 1, np.inf)
    best[0] = -each
    last = np.zeros(n + 1, int)
    for end in range(LEAST, n + 1):
        starts = np.arange(0, end - LEAST + 1)
        weight, first = S0[end] - S0[starts], S1[end] - S1[starts]
        cost = S2[end] - S2[starts] - first**2 / weight
        total = best[starts] + cost + each
        last[end] = starts[np.argmin(total)]
        best[end] = total[last[end]]
    edges = [n]
    while edges[-1] > 0:
        edges.append(int(last[edges[-1]]))
    return edges[::-1]


def _is_line(t: Array, values: Array, variance: Array, edges: list[int]) -> bool:
    """Whether one slope explains the values as well as the steps do, which would be a staircase."""
    steps = 0.0
    for first, last in pairwise(edges):
        level = np.average(values[first:last], weights=1 / variance[first:last])
        steps += float(np.sum((values[first:last] - level) ** 2 / variance[first:last]))
    slope, _ = trend(t, values, variance)
    w = 1 / variance
    x, y = t - np.average(t, weights=w), values - np.average(values, weights=w)
    line = float(np.sum(w * (y - slope * x) ** 2))
    each = penalty(len(values))
    return line + each <= steps + each * (len(edges) - 2)


def trend(t: Array, values: Array, variance: Array) -> tuple[float, float]:
    """Slope of the weighted line, and its standard deviation."""
    if len(t) < LEAST_FOR_TREND or not np.ptp(t) > 0:
        return 0.0, float("inf")
    w = 1 / variance
    x = t - np.average(t, weights=w)
    size = float(np.sum(w * x * x))
    return float(np.sum(w * x * values)) / size, float(size**-0.5)


def _segment(values: Array, variance: Array, first: int, last: int) -> Segment:
    w = 1 / variance[first:last]
    mean = float(np.average(values[first:last], weights=w))
    return Segment(first, last, mean, float(np.sum(w) ** -0.5))
