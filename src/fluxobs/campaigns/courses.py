"""Courses of speed and load: given by the specification, or random."""

from __future__ import annotations

import numpy as np

from .draws import COURSE, Scenario
from .specification import CourseTable

#: Knots of a piecewise linear course: (time [s], share of the rated value).
Knots = list[tuple[float, float]]


def course_of(table: CourseTable, scenario: Scenario) -> tuple[Knots, Knots]:
    """Return speed and load of a scenario over time, as shares of the rated values."""
    rng = scenario.generator(COURSE)
    speed = _random_speed(table, rng) if table.speed == "random" else list(table.speed)
    load = _random_load(table, rng) if table.load == "random" else list(table.load)
    return speed, load


def max_knots(table: CourseTable) -> int:
    """Return the largest possible number of knots in a course of this table."""
    segments = int(np.ceil(table.duration / table.segment[0])) + 1
    specified = [len(knots) for knots in (table.speed, table.load) if knots != "random"]
    return max([2 * segments + 2, *specified])


def _draw_uniform(rng: np.random.Generator, limits: list[float]) -> float:
    return float(rng.uniform(limits[0], limits[1]))


def _draw_segment_starts(table: CourseTable, rng: np.random.Generator) -> list[float]:
    """Draw the starts of the random segments [s]."""
    starts = [0.0]
    while starts[-1] < table.duration:
        starts.append(starts[-1] + _draw_uniform(rng, table.segment))
    return starts[:-1]


def _random_speed(table: CourseTable, rng: np.random.Generator) -> Knots:
    """Draw ramps to random speeds from standstill, with stops and reversals."""
    knots, sign = [(0.0, 0.0)], rng.choice([-1.0, 1.0])
    for k, start in enumerate(_draw_segment_starts(table, rng)):
        sign = -sign if rng.random() < table.reversals else sign
        magnitude = float(np.exp(_draw_uniform(rng, np.log(table.speeds).tolist())))
        stops = rng.random() < table.stops and k > 0  # the first segment starts the drive
        target = 0.0 if stops else float(sign * magnitude)
        # A segment may begin before the previous ramp ends: continue from the speed reached.
        reached = _interpolate(knots, start)
        knots = [knot for knot in knots if knot[0] < start] + [(start, reached)]
        knots.append((start + table.ramp * max(abs(target - reached), 1e-3), target))
    return knots


def _interpolate(knots: Knots, t: float) -> float:
    times, values = zip(*knots, strict=True)
    return float(np.interp(t, times, values))


def _random_load(table: CourseTable, rng: np.random.Generator) -> Knots:
    """Draw steps of the load; the first segment has no load."""
    knots, value = [(0.0, 0.0)], 0.0
    for start in _draw_segment_starts(table, rng)[1:]:
        knots.append((start, value))
        value = _draw_uniform(rng, table.loads)
        knots.append((start, value))
    return knots
