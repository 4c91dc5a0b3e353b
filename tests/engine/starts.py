"""Hints for the engine: the angles of the observers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from engine.estimates import estimate
from engine.likelihood import Array, Complex
from engine.machines import machine_file, measured
from fluxobs.estimation.anchors import anchors_of, forwards, joined_pieces
from fluxobs.estimation.passes import Passes
from fluxobs.estimation.whole_log import WholeLog
from fluxobs.inference.posterior import Posterior
from fluxobs.logs.for_machine import open_for
from fluxobs.machines.rotating import RotatingMachine
from fluxobs.observers.unknowns import AUTO

#: Rows that the engine needs to begin with (engine/growth.c), and the deviation of an angle that is
#: a hint if so many rows are not valid [rad].
FIRST = 40
POOR = 0.3


def hints(
    voltage: Complex,
    current: Complex,
    sample_time: float,
    machine: RotatingMachine,
    lag: float,
) -> tuple[Array, bool]:
    """Return the angle of the observers where it is valid, NaN elsewhere, and whether it is sure.

    They run twice, with the machine file and with what the first run has learnt. Where neither is
    valid for long enough, less certain angles count, which are not sure.

    Parameters
    ----------
    lag : float
        That the voltages act later than the log says [samples].
    """
    log = open_for((voltage, current), machine, sample_time=sample_time, lag=-lag + 0.0)
    first = Passes.begun(log, machine, (AUTO,), None, {}, causal=True)
    whole = Passes.begun(log, machine, (AUTO,), None, {}, causal=False).whole
    assert isinstance(whole, WholeLog)
    runs = [
        joined_pieces([piece for _, piece in forwards(run, state)])
        for run, state in ((first.run, first.state), (whole.run, whole.state))
    ]
    valid = runs[0].valid & np.isfinite(runs[0].angle)
    sure = longest_run(valid) >= FIRST
    known = anchors_of(runs[1])
    if not sure and longest_run(known) < FIRST:
        known = known | (runs[1].angle_std < POOR)
    second = np.where(known, runs[1].angle, np.nan)
    return np.where(valid, runs[0].angle, second), sure


def longest_run(known: NDArray[np.bool_]) -> int:
    ends = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]])))
    return int((ends[1::2] - ends[::2]).max(initial=0))


def started(
    voltage: Complex,
    current: Complex,
    sample_time: float,
    machine: RotatingMachine,
    rated_current: float,
    lag: tuple[float, float],
    ordinary: bool = False,
) -> Posterior:
    """Estimate a log from the angles of the observers.

    Parameters
    ----------
    lag : (float, float)
        That the voltages act later than the log says: mean and std [samples].
    ordinary : bool
        The drive has errors of its sensors, iron loss and heat.

    Raises
    ------
    NoEstimate
        The observers are not valid for long enough, or the log contradicts them.
    """
    volts = float(np.sqrt(np.nanmean(np.abs(voltage) ** 2)))
    file = machine_file(
        machine, sample_time, lag, rated_current, voltage=volts if ordinary else None
    )
    applied, own = measured(voltage, current, sample_time)
    angle, sure = hints(voltage, current, sample_time, machine, lag[0])
    return estimate(applied, own, sample_time, file, angle, sure=sure)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
