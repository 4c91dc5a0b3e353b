"""First courses of the engine: from the forward observer, and from the smoother."""

from __future__ import annotations

import numpy as np

from engine.estimates import Estimate, NoEstimate, estimate
from engine.likelihood import Array, Complex
from engine.machines import machine_file, measured
from fluxobs.estimation.anchors import anchors_of, forwards, joined_pieces
from fluxobs.estimation.passes import Passes
from fluxobs.estimation.whole_log import WholeLog
from fluxobs.logs.for_machine import open_for
from fluxobs.machines.model.frames import wrap
from fluxobs.machines.rotating import RotatingMachine
from fluxobs.observers.adaptive import Learnt
from fluxobs.observers.unknowns import AUTO
from fluxobs.smoothing.record import smooth_record

#: A course that differs from another by less than this is the same start [rad].
SAME = 0.5


def unwrapped(angle: Array) -> Array | None:
    """Return the angle without gaps and jumps of a turn; None: no row has one."""
    known = np.isfinite(angle)
    if not known.any():
        return None
    at = np.arange(len(angle))
    return np.interp(at, at[known], np.unwrap(angle[known]))


def differ(one: Array, other: Array) -> bool:
    """Whether two courses are different starts."""
    return float(np.abs(wrap(one - other)).max()) > SAME


def first_courses(
    voltage: Complex,
    current: Complex,
    sample_time: float,
    machine: RotatingMachine,
    lag: float,
) -> tuple[Array, Learnt | None]:
    """Return courses of the angle, a row each, and what the observer learnt.

    They come from the observer forwards, and from each start of the smoother: it joins what the
    observers know, and may lose a turn where they know nothing.

    Parameters
    ----------
    lag : float
        That the voltages act later than the log says [samples].

    Raises
    ------
    NoEstimate
        The observer is not valid anywhere.
    """
    log = open_for((voltage, current), machine, sample_time=sample_time, lag=-lag + 0.0)
    whole = Passes.begun(log, machine, (AUTO,), None, {}, causal=False).whole
    assert isinstance(whole, WholeLog)
    rows = joined_pieces([piece for _, piece in forwards(whole.run, whole.state)])
    anchors = anchors_of(rows)
    if anchors.sum() < 2:
        raise NoEstimate
    model = whole._model_for(rows, anchors)
    whole.starts.in_parts = False
    angles = [rows.angle]
    for start in whole.starts._of(model, rows, anchors):
        smoothed = smooth_record(start.model, start.samples, start.assumed, learning=True)
        angles.append(smoothed.outputs["theta_e"])
    courses: list[Array] = []
    for course in map(unwrapped, angles):
        if course is not None and all(differ(course, other) for other in courses):
            courses.append(course)
    if not courses:
        raise NoEstimate
    return np.array(courses), whole.learnt


def started(
    voltage: Complex,
    current: Complex,
    sample_time: float,
    machine: RotatingMachine,
    rated_current: float,
    lag: tuple[float, float],
    ordinary: bool = False,
) -> Estimate:
    """Estimate a log from the course and the parameters of the observers.

    Parameters
    ----------
    lag : (float, float)
        That the voltages act later than the log says: mean and std [samples].
    ordinary : bool
        The drive has errors of its sensors, iron loss and heat.

    Raises
    ------
    NoEstimate
        The observer is not valid anywhere, or the log contradicts its course.
    """
    volts = float(np.sqrt(np.nanmean(np.abs(voltage) ** 2)))
    file = machine_file(
        machine, sample_time, lag, rated_current, voltage=volts if ordinary else None
    )
    own = measured(voltage, current, sample_time)
    courses, learnt = first_courses(voltage, current, sample_time, machine, lag[0])
    begin = {}
    if learnt is not None:
        begin = {
            "resistance": np.log(max(learnt.resistance, 0.3 * machine.R_s)),
            "loss": np.log(max(learnt.inverter_voltage, 1e-3 * volts)),
        }
        if file.psi_f > 0:
            begin["psi_f"] = np.log(max(learnt.psi_f, 0.3 * file.psi_f))
    return estimate(voltage, own, sample_time, file, courses, begin)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
