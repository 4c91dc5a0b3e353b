"""Where the engine starts: the observer forwards, and one pass of the smoother over the log."""

from __future__ import annotations

import numpy as np

from engine.estimates import Estimate, NoEstimate, estimate
from engine.likelihood import Array, Complex
from engine.machines import machine_file, measured
from fluxobs.estimation.anchors import anchors_of, forwards, joined_pieces
from fluxobs.estimation.passes import Passes
from fluxobs.estimation.whole_log import WholeLog
from fluxobs.logs.for_machine import open_for
from fluxobs.machines.rotating import RotatingMachine
from fluxobs.observers.adaptive import Learnt
from fluxobs.observers.unknowns import AUTO
from fluxobs.smoothing.record import smooth_record


def first_course(
    voltage: Complex,
    current: Complex,
    sample_time: float,
    machine: RotatingMachine,
    lag: float,
) -> tuple[Array, Learnt | None]:
    """Return the angle of each row, without jumps of a turn, and what the observer learnt.

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
    start = next(whole.starts._of(model, rows, anchors))
    smoothed = smooth_record(start.model, start.samples, start.assumed, learning=True)
    angle = smoothed.outputs["theta_e"]
    known = np.isfinite(angle)
    if not known.any():
        raise NoEstimate
    at = np.arange(len(angle))
    return np.interp(at, at[known], np.unwrap(angle[known])), whole.learnt


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
    angle, learnt = first_course(voltage, current, sample_time, machine, lag[0])
    begin = {}
    if learnt is not None:
        begin = {
            "resistance": np.log(max(learnt.resistance, 0.3 * machine.R_s)),
            "loss": np.log(max(learnt.inverter_voltage, 1e-3 * volts)),
        }
        if file.psi_f > 0:
            begin["psi_f"] = np.log(max(learnt.psi_f, 0.3 * file.psi_f))
    return estimate(voltage, own, sample_time, file, angle, begin)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
