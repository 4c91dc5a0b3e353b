"""Estimates from the angles of the observers."""

from __future__ import annotations

import numpy as np

from engine.estimates import estimate
from engine.likelihood import Array, Complex
from engine.machines import machine_file, measured
from fluxobs.estimation.hints import Hints, hints_of
from fluxobs.estimation.passes import Passes
from fluxobs.inference.posterior import Posterior
from fluxobs.logs.for_machine import open_for
from fluxobs.machines.rotating import RotatingMachine
from fluxobs.observers.unknowns import AUTO


def hints(
    voltage: Complex,
    current: Complex,
    sample_time: float,
    machine: RotatingMachine,
    lag: float,
) -> Hints:
    """Return the hints of the observers.

    Parameters
    ----------
    lag : float
        That the voltages act later than the log says [samples].
    """
    log = open_for((voltage, current), machine, sample_time=sample_time, lag=-lag + 0.0)
    return hints_of(Passes.begun(log, machine, (AUTO,), None, {}, causal=True).run)


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
    own_hints = hints(voltage, current, sample_time, machine, lag[0])
    return estimate(applied, own, sample_time, file, own_hints.angle, sure=own_hints.sure)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
