"""Courses of speed and load: those of the specification, or random ones."""

from __future__ import annotations

import numpy as np

from .draws import COURSE, Scenario
from .specification import CourseTable

#: Knots in time [s] with shares of the rated value.
Knots = list[tuple[float, float]]


def course_of(table: CourseTable, scenario: Scenario) -> tuple[Knots, Knots]:
    """Speed and load of a scenario, as shares of the rated values over time."""
    rng = scenario.generator(COURSE)
    speed = _speed(table, rng) if table.speed == "random" else list(table.speed)
    load = _load(table, rng) if table.load == "random" else list(table.load)
    return speed, load


def most_knots(table: CourseTable) -> int:
    """Knots that no profile of these courses exceeds."""
    segments = int(np.ceil(table.duration / table.segment[0])) + 1
    given = [len(knots) for knots in (table.speed, table.load) if knots != "random"]
    return max([2 * segments + 2, *given])


def _between(rng: np.random.Generator, limits: list[float]) -> float:
    return float(rng.uniform(limits[0], limits[1]))


def _segments(table: CourseTable, rng: np.random.Generator) -> list[float]:
    """Starts of the random segments [s]."""
    starts = [0.0]
    while starts[-1] < table.duration:
        starts.append(starts[-1] + _between(rng, table.segment))
    return starts[:-1]


def _speed(table: CourseTable, rng: np.random.Generator) -> Knots:
    """Ramps to random speeds, with stops and reversals, from standstill."""
    knots, sign = [(0.0, 0.0)], rng.choice([-1.0, 1.0])
    for k, start in enumerate(_segments(table, rng)):
        sign = -sign if rng.random() < table.reversals else sign
        size = float(np.exp(_between(rng, np.log(table.speeds).tolist())))
        stops = rng.random() < table.stops and k > 0  # the first segment starts the drive
        target = 0.0 if stops else float(sign * size)
        # The next segment may begin before the ramp ends: it goes on from there.
        now = _at(knots, start)
        knots = [knot for knot in knots if knot[0] < start] + [(start, now)]
        knots.append((start + table.ramp * max(abs(target - now), 1e-3), target))
    return knots


def _at(knots: Knots, t: float) -> float:
    times, values = zip(*knots, strict=True)
    return float(np.interp(t, times, values))


def _load(table: CourseTable, rng: np.random.Generator) -> Knots:
    """Steps of the load, none in the first segment."""
    knots, value = [(0.0, 0.0)], 0.0
    for start in _segments(table, rng)[1:]:
        knots.append((start, value))
        value = _between(rng, table.loads)
        knots.append((start, value))
    return knots
