"""The closed-loop track: the entrant's angle and speed control a simulated drive.

A rotating current vector starts the drive. The entrant enters the loop while it calls its position
valid, with a standard deviation below 10° if it states one. Without a validity flag, it is trusted
above 5 % of the rated speed, as in firmware.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..campaigns.drives import Cell, cell_of
from ..campaigns.in_loop import READY, Reading, in_loop
from ..campaigns.observed import NOISE, TRUSTED, candidate
from ..campaigns.scores import loop_measures
from ..campaigns.simulated import ScoredTrace, select_scored
from ..campaigns.specification import ObserverTable, Specification
from ..comparison.scoring import true_speed
from ..errors import FluxobsError
from ..simulation.drive import Drive, sensorless_drive
from ..simulation.drive.sensorless import RUNNING
from ..simulation.precision import real
from .draws import ERRORS, LOOP_COURSES, MACHINES
from .drives import lanes, run
from .entrants import OURS, Entrant, Estimates, published
from .programs import OUTPUTS, Create, Stepped
from .scores import Score, Truth, score
from .suite import Entry, Suite

#: Duration of a simulation [s], and the time from which a drive is scored: it starts in open loop.
DURATION, SCORE_FROM = 4.0, 1.5
#: Largest speed of the open-loop start, as a share of the rated speed: most observers that state a
#: standard deviation know the position there.
START = 0.3
#: Bandwidth of the phase-locked loop that gives a speed to entrants without one [rad/s].
TRACKER = 2 * np.pi * 15


class _Lane:
    """An entrant's observer in a drive, with a speed if it has none."""

    def __init__(self, observer: Stepped, sample_time: float, trusted: float) -> None:
        self.observer, self.h, self.trusted = observer, sample_time, trusted
        self.angle, self.speed = 0.0, 0.0

    def step(self, voltage: Any, current: Any) -> tuple[float, float, float, float]:
        """Return angle, standard deviation, validity and speed."""
        got = self.observer.step(voltage, current)
        values = got if isinstance(got, tuple) else (got,)
        stated = dict(zip(OUTPUTS, (float(value) for value in values), strict=False))
        theta = stated["theta_e"]
        if not np.isfinite(theta):
            return 0.0, np.inf, 0.0, 0.0
        speed = stated.get("speed_e", np.nan)
        if not np.isfinite(speed):
            error = (theta - self.angle + np.pi) % (2 * np.pi) - np.pi
            self.speed += self.h * TRACKER**2 * error
            self.angle += self.h * (self.speed + 2 * TRACKER * error)
            speed = self.speed
        std, valid = stated.get("theta_e_std", np.nan), stated.get("valid", np.nan)
        if np.isnan(valid):
            valid = 1.0 if np.isfinite(std) else float(abs(speed) > self.trusted)
        return theta, 0.0 if np.isnan(std) else std, valid, speed


class _Lanes:
    """The observers of a batch of drives, called sample by sample."""

    def __init__(self, make: Callable[[], _Lane]) -> None:
        self.make, self.observers = make, dict[int, _Lane]()

    def step(self, lane: Any, count: Any, voltage: Any, current: Any) -> tuple[Any, Any]:
        """Step all lanes; a count of zero begins a simulation."""
        lanes, u, i = np.atleast_1d(lane), np.atleast_2d(voltage), np.atleast_2d(current)
        out = np.empty((len(lanes), 4))
        for k, number in enumerate(lanes):
            if np.atleast_1d(count)[0] == 0:
                self.observers[int(number)] = self.make()
            out[k] = self.observers[int(number)].step(u[k], i[k])
        return out.reshape(*np.shape(lane), 4), np.asarray(count + 1, np.int32)


class InPython(eqx.Module):
    """An observer that a simulated drive calls in Python, once a sample for all drives."""

    lane: Array
    psi_f: Array
    sample_time: Array
    lanes: _Lanes = eqx.field(static=True)

    def init(self) -> Array:
        """Return the number of steps: the state that orders the calls."""
        return jnp.zeros((), jnp.int32)

    def step(self, state: Array, voltage: Array, current: Array) -> tuple[Array, Reading]:
        """Process a sample."""
        struct: Any = jax.ShapeDtypeStruct
        shapes = (struct((4,), jnp.float64), struct((), jnp.int32))
        values, state = jax.pure_callback(
            self.lanes.step,
            shapes,
            *(self.lane, state, voltage, current),
            vmap_method="broadcast_all",
        )
        return state, Reading(values[0], values[3], self.psi_f, values[1], values[2] > 0.5)


def score_in_loop(
    entrant: Entrant,
    suite: Suite,
    drives: int = 1,
    progress: Callable[[int, int], Any] | None = None,
) -> list[Score]:
    """Simulate the drives of a suite with an entrant in the loop, and score it.

    Valid rows are those on which the drive uses the entrant. A drive is lost if it trips, diverges,
    or does not follow its speed reference.

    Parameters
    ----------
    entrant, suite
    drives : int
        Drives of each machine, course and kind of errors.

    Raises
    ------
    FluxobsError
        The entrant cannot be in a loop, or the suite is measured.
    """
    if entrant.track != "causal" or not (entrant.create or entrant.name in (*OURS, *published())):
        raise FluxobsError(f"{entrant.name} is not a causal observer that can be in a loop")
    if suite.measured:
        raise FluxobsError(f"{suite.folder}: measured records cannot be run in closed loop")
    scores = []
    cells = [(course, errors) for course in LOOP_COURSES for errors in ERRORS]
    for n, machine in enumerate(MACHINES):
        found = [
            (f"{machine}-{course}-{errors}-{k}".replace(" ", "-"), course, errors, lane)
            for course, errors in cells
            for k, lane in enumerate(
                lanes(
                    *(machine, course, drives, suite.seed, ERRORS[errors]), LOOP_COURSES, DURATION
                )
            )
        ]
        cell = cell_of(_specification(machine), machine)
        equip = _equipped(entrant, suite, cell)
        if equip is not None:
            equipped = [
                lane._replace(drive=equip(lane.drive, k)) for k, (*_, lane) in enumerate(found)
            ]
            finished, trace = run(equipped, select_scored, DURATION)
            for k, (name, course, errors, lane) in enumerate(found):
                entry = Entry(name, machine, course, errors, float(lane.drive.sample_time))
                row = ScoredTrace(*(signal[k] for signal in trace))
                scores.append(_score(entrant, suite, entry, row, bool(finished[k])))
        if progress is not None:
            progress(n + 1, len(MACHINES))
    return scores


def _specification(machine: str) -> Specification:
    return Specification.model_validate(
        {"name": "benchmark", "scenarios": 1, "machines": [machine], "observers": ["plain"]}
    )


def _equipped(entrant: Entrant, suite: Suite, cell: Cell) -> Callable[[Drive, int], Drive] | None:
    """Return what puts an entrant into a drive; None if it has no observer for the machine."""
    h = cell.rated.sample_time
    if entrant.create is None:
        try:
            usual = in_loop(
                candidate(ObserverTable(kind=entrant.name), cell, NOISE * cell.current), cell
            )
        except FluxobsError:  # no such observer for this machine
            return None
        return lambda drive, lane: usual(drive)
    create: Create = entrant.create
    file = suite.folder / "machines" / f"{cell.name}.toml"
    if create(file, h) is None:
        return None
    trusted = TRUSTED * cell.rated.speed_e

    def make() -> _Lane:
        observer = create(file, h)
        assert observer is not None
        return _Lane(observer, h, trusted)

    together = _Lanes(make)
    drive_of_cell: Drive = sensorless_drive(cell.machine, cell.rated)
    sensorless = drive_of_cell.sensorless
    assert sensorless is not None
    speed = np.maximum(sensorless.speed, START * cell.rated.speed_e)
    sensorless = replace(sensorless, ready=real("ready", READY), speed=real("speed", speed))

    def equip(drive: Drive, lane: int) -> Drive:
        observer = InPython(
            jnp.asarray(lane), real("psi_f", cell.flux), real("sample_time", h), together
        )
        return replace(
            drive, observer=observer, sensorless=sensorless, control=drive_of_cell.control
        )

    return equip


def _score(
    entrant: Entrant, suite: Suite, entry: Entry, trace: ScoredTrace, finished: bool
) -> Score:
    rows = len(trace.theta_e)
    machine = suite.machine(entry)
    truth: Truth = {
        "theta_e": trace.theta_e,
        "speed_e": true_speed(machine, trace.theta_e, trace.speed, entry.sample_time),
    }
    running = np.asarray(trace.mode == RUNNING)
    stated = np.asarray(trace.std)
    estimates = Estimates(
        np.asarray(trace.angle),
        stated if (stated[running] > 0).any() else None,
        running,
        np.asarray(trace.seen_speed),
    )
    scored = score(entrant.name, machine, entry, truth, estimates)
    t = np.asarray(entry.sample_time * np.arange(rows), float)
    drive = loop_measures(t, trace, SCORE_FROM)
    lost = 1.0 if drive["tripped"] or not finished else drive["unfollowed"]
    return replace(scored, lost=float(lost))
