"""Simulate drives in batches; the results of a drive do not depend on the rest of its batch.

A batch always has the same number of lanes, padded with copies. Every drive then runs the same
compiled code, whatever its batch contains.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..errors import FluxobsError
from ..simulation.drive import Course, Drive, Trace
from ..simulation.drive.simulate import check, simulate_lanes, substeps
from .courses import max_knots
from .draws import NOISE, Scenario
from .drives import drive_of
from .specification import Specification

#: Number of drives simulated at once in open and in closed loop. 64 drives fill the vector units
#: without remainder. 256 in closed loop dates from observers that were called outside the compiled
#: loop, at the cost of 80 drives a call; it has not been measured again since.
LANES, IN_LOOP = 64, 256
#: Largest product of samples and lanes of a batch. 14 doubles for each sample and lane need half a
#: gigabyte.
MAX_SAMPLES = 1 << 22


class ScoredTrace(NamedTuple):
    """The quantities of a trace that are scored; vectors are complex."""

    current: Any
    voltage: Any
    theta_e: Any
    speed: Any
    mode: Any
    tripped: Any
    limited: Any
    reference: Any
    angle: Any
    valid: Any
    std: Any
    seen_speed: Any


def select_scored(row: Trace) -> ScoredTrace:
    """Return the scored quantities of a trace; zeros for a missing observer."""
    reading = row.reading
    observer_values = (0 * row.theta_e, row.tripped, 0 * row.theta_e, 0 * row.theta_e)
    if reading is not None:
        observer_values = (reading.theta_e, reading.valid, reading.theta_e_std, reading.speed_e)
    return ScoredTrace(
        row.measured_current,
        row.voltage,
        row.theta_e,
        row.speed,
        row.mode,
        row.tripped,
        row.voltage_limited,
        row.reference,
        *observer_values,
    )


class Simulated(NamedTuple):
    """One simulated drive: its trace, or the reason for its failure."""

    scenario: Scenario
    drive: Drive | None
    trace: ScoredTrace | None
    failed: str


def lanes_for(specification: Specification, sample_time: float) -> int:
    """Return the number of lanes of a batch; fewer for long records, to limit the memory."""
    lanes = LANES if specification.loop == "open" else IN_LOOP
    rows = specification.course.duration / sample_time
    while lanes > 8 and lanes * rows > MAX_SAMPLES:
        lanes //= 2
    return lanes


def simulated(
    specification: Specification,
    scenarios: Sequence[Scenario],
    lanes: int,
    equip: Callable[[Drive], Drive] = lambda drive: drive,
) -> Iterator[Simulated]:
    """Simulate scenarios of one machine; yield the results unsorted.

    Parameters
    ----------
    lanes : int
        Drives per batch.
    equip : callable
        Adds the parts that all drives share, for example an observer in the loop.
    """
    groups: dict[Any, list[tuple[Scenario, Drive, Course]]] = {}
    for scenario in scenarios:
        try:
            drive, course = drive_of(specification, scenario)
            drive = equip(drive)
            check(drive, course)
            steps = substeps(drive, course)
        except FluxobsError as error:
            yield Simulated(scenario, None, None, str(error))
            continue
        # The step count depends only on this drive. Powers of two limit the number of groups.
        rounded_steps = 1 << (steps - 1).bit_length()
        groups.setdefault(rounded_steps, []).append((scenario, drive, course))
    knots = max_knots(specification.course)
    for steps, members in sorted(groups.items()):
        for first in range(0, len(members), lanes):
            yield from _batch(specification, members[first : first + lanes], steps, lanes, knots)


def _batch(
    specification: Specification,
    members: list[tuple[Scenario, Drive, Course]],
    steps: int,
    lanes: int,
    knots: int,
) -> Iterator[Simulated]:
    drive = members[0][1]
    samples = round(specification.course.duration / float(drive.sample_time))
    padded = members + members[:1] * (lanes - len(members))
    noise = np.empty((lanes, samples, 3))
    for k, (scenario, _, _) in enumerate(members):
        scenario.generator(NOISE).standard_normal(out=noise[k])
    noise[len(members) :] = noise[0]
    finite, trace = simulate_lanes(
        [(d, c) for _, d, c in padded], noise, steps, select_scored, knots
    )
    for k, (scenario, drive, _) in enumerate(members):
        if finite[k]:
            yield Simulated(scenario, drive, ScoredTrace(*(signal[k] for signal in trace)), "")
        else:
            yield Simulated(
                scenario, drive, None, "the simulation diverged: its result is not finite"
            )
