"""Simulated drives with known position, speed and torque."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..campaigns.draws import NOISE, Scenario
from ..campaigns.drives import drive_of
from ..campaigns.simulated import ScoredTrace, select_scored
from ..campaigns.specification import Specification
from ..comparison.scoring import true_speed
from ..core.arrays import Array
from ..errors import FluxobsError
from ..machines import example, rotating
from ..simulation.drive import Course as TrueCourse
from ..simulation.drive import Drive as TrueDrive
from ..simulation.drive.simulate import Trace, check, simulate_lanes, substeps
from .draws import COURSES, MACHINES, Draw

#: Duration of a record [s].
DURATION = 2.5
#: Share of the rows that half of the loggers lose, at most.
LOST = 0.002
#: Knots to which the courses are padded, so that all drives of a machine run the same code.
KNOTS = 30


@dataclass(frozen=True, eq=False)
class Drive:
    """A simulated log with its truth; vectors are complex, α + j β.

    Attributes
    ----------
    machine, course : str
    sample_time : float
        [s].
    voltage, current : (rows,) ndarray
        Commanded voltage from the row on [V], measured current [A]; NaN where the logger lost it.
    theta, speed_e, torque : (rows,) ndarray
        Electrical position [rad] and speed [rad/s], torque [N m].
    mechanics : (float, float, float)
        J [kg m²], viscous [N m s/rad] and Coulomb friction [N m].
    values : dict
        The errors, as quantities of a campaign.
    """

    machine: str
    course: str
    sample_time: float
    voltage: Array
    current: Array
    theta: Array
    speed_e: Array
    torque: Array
    mechanics: tuple[float, float, float]
    values: dict[str, float]


class _Kept(NamedTuple):
    """What is kept of a simulation."""

    scored: ScoredTrace
    torque: Any


def _select(row: Trace) -> _Kept:
    return _Kept(select_scored(row), row.torque)


class Lane(NamedTuple):
    """A drive of the benchmark before its simulation."""

    drive: TrueDrive
    course: TrueCourse
    scenario: Scenario


def lanes(
    machine: str,
    course: str,
    drives: int,
    seed: int,
    draw: Draw,
    courses: Mapping[str, Mapping[str, Any]] = COURSES,
    duration: float = DURATION,
) -> list[Lane]:
    """Return drives of a shipped machine that can reach the speeds and loads of a course."""
    place = [seed, MACHINES.index(machine), list(courses).index(course)]
    rng = np.random.default_rng(place)
    specification = Specification.model_validate(
        {
            **{"name": "benchmark", "seed": seed, "scenarios": drives, "machines": [machine]},
            **{"loop": "open", "observers": ["plain"], "vary": {}},
            "course": {
                **{"duration": duration, "score_from": 0.0, "loads": [-0.8, 0.8], "ramp": 0.4},
                **{"segment": [0.3, 0.9], **courses[course]},
            },
        }
    )
    found = []
    for n in range(drives):
        values = draw(rng, machine)
        scenario = Scenario(1000 * place[2] + n, specification.machines[0], values, seed)
        try:
            lane = drive_of(specification, scenario)
            check(*lane)
            substeps(*lane)
        except FluxobsError:  # the drive cannot reach this speed or load
            continue
        found.append(Lane(*lane, scenario))
    return found


def run(
    found: Sequence[Lane], keep: Callable[[Trace], Any], duration: float = DURATION
) -> tuple[Any, Any]:
    """Simulate drives with equal components; return which stayed finite, and what `keep` keeps."""
    rows = round(duration / float(found[0].drive.sample_time))
    noise = [lane.scenario.generator(NOISE).standard_normal((rows, 3)) for lane in found]
    steps = max(substeps(lane.drive, lane.course) for lane in found)
    pairs = [(lane.drive, lane.course) for lane in found]
    return simulate_lanes(pairs, np.stack(noise), steps, keep, KNOTS)


def simulated(machine: str, course: str, drives: int, seed: int, draw: Draw) -> list[Drive]:
    """Return drives of a shipped machine on a course; those that trip or diverge are left out.

    Parameters
    ----------
    draw : callable
        Draws the errors of a drive.
    """
    found = lanes(machine, course, drives, seed, draw)
    if not found:
        return []
    h = float(found[0].drive.sample_time)
    finished, (trace, torque) = run(found, _select)
    model = rotating(example(machine), "a benchmark")
    place = [seed, MACHINES.index(machine), list(COURSES).index(course)]
    done = []
    for n, lane in enumerate(found):
        if not finished[n] or trace.tripped[n].any():
            continue
        current, theta = np.array(trace.current[n]), np.array(trace.theta_e[n])
        lost = np.random.default_rng([*place, n])
        if lost.random() < 0.5:
            current[lost.random(len(current)) < lost.uniform(0, LOST)] = np.nan
        plant = lane.drive.plant.mechanics
        done.append(
            Drive(
                *(machine, course, h, np.array(trace.voltage[n]), current, theta),
                true_speed(model, theta, np.array(trace.speed[n]), h),
                np.array(torque[n]),
                (float(plant.J), float(plant.viscous), float(plant.coulomb)),
                lane.scenario.values,
            )
        )
    return done
