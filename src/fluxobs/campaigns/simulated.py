"""Batches of drives, simulated so that a drive's numbers depend on nothing but the drive.

A batch has always the same number of lanes, filled up with copies: the compiled code is then the
same for every drive, whichever others it is simulated with.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..errors import FluxobsError
from ..simulation.drive import Course, Drive, Trace
from ..simulation.drive.simulate import check, simulate_lanes, substeps
from .courses import most_knots
from .draws import NOISE, Scenario
from .drives import drive_of
from .specification import Specification

#: Drives simulated at once: 64 fill the vector units, and leave nothing over in them. In the loop a
#: call from the compiled loop to the observers costs as much as 80 drives: more at once.
LANES, IN_LOOP = 64, 256
#: Rows times lanes of a batch [numbers], at most: 14 doubles for each are half a
#: gigabyte.
MOST = 1 << 22


class Kept(NamedTuple):
    """What is kept of every row of a trace; vectors are complex."""

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


def keep(row: Trace) -> Kept:
    """The rows of a trace that are scored; of a drive without an observer, zeros for it."""
    reading = row.reading
    own = (0 * row.theta_e, row.tripped, 0 * row.theta_e, 0 * row.theta_e)
    if reading is not None:
        own = (reading.theta_e, reading.valid, reading.theta_e_std, reading.speed_e)
    return Kept(
        row.measured_current,
        row.voltage,
        row.theta_e,
        row.speed,
        row.mode,
        row.tripped,
        row.voltage_limited,
        row.reference,
        *own,
    )


class Simulated(NamedTuple):
    """One simulated drive: its trace, or why there is none."""

    scenario: Scenario
    drive: Drive | None
    trace: Kept | None
    failed: str


def lanes_for(specification: Specification, sample_time: float) -> int:
    """Lanes of a batch: fewer where records are so long that memory would not hold them."""
    lanes = LANES if specification.loop == "open" else IN_LOOP
    rows = specification.course.duration / sample_time
    while lanes > 8 and lanes * rows > MOST:
        lanes //= 2
    return lanes


def simulated(
    specification: Specification,
    scenarios: Sequence[Scenario],
    lanes: int,
    equip: Callable[[Drive], Drive] = lambda drive: drive,
) -> Iterator[Simulated]:
    """Simulate scenarios of one machine; in no particular order.

    Parameters
    ----------
    lanes : int
        Drives of a batch.
    equip : callable
        Adds what is alike in all drives, as an observer in the loop.
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
        # A drive's steps are its own: a power of two, so that there are few groups.
        group = 1 << (steps - 1).bit_length()
        groups.setdefault(group, []).append((scenario, drive, course))
    knots = most_knots(specification.course)
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
    rows = round(specification.course.duration / float(drive.sample_time))
    filled = members + members[:1] * (lanes - len(members))
    noise = np.empty((lanes, rows, 3))
    for k, (scenario, _, _) in enumerate(members):
        scenario.generator(NOISE).standard_normal(out=noise[k])
    noise[len(members) :] = noise[0]
    finite, trace = simulate_lanes([(d, c) for _, d, c in filled], noise, steps, keep, knots)
    for k, (scenario, drive, _) in enumerate(members):
        if finite[k]:
            yield Simulated(scenario, drive, Kept(*(part[k] for part in trace)), "")
        else:
            yield Simulated(scenario, drive, None, "the simulation ends without a number")
