"""Where the engine starts: courses and parameters of today's whole-log and causal estimates."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

import fluxobs
from engine.estimates import Estimate, NoEstimate, estimate
from engine.likelihood import Array, Complex
from engine.machines import machine_file, measured
from fluxobs.machines.rotating import RotatingMachine


def started(
    voltage: Complex,
    current: Complex,
    sample_time: float,
    machine: RotatingMachine,
    rated_current: float,
    lag: tuple[float, float],
    ordinary: bool = False,
) -> Estimate:
    """Estimate a log from the whole-log and from the causal estimate: the better objective wins.

    The whole-log estimate gives two starts, with what it learnt and with the machine file.

    Parameters
    ----------
    lag : (float, float)
        That the voltages act later than the log says: mean and std [samples].
    ordinary : bool
        The drive has errors of its sensors, iron loss and heat.

    Raises
    ------
    NoEstimate
        The log contradicts both starts.
    """
    volts = float(np.sqrt(np.nanmean(np.abs(voltage) ** 2)))
    file = machine_file(
        machine, sample_time, lag, rated_current, voltage=volts if ordinary else None
    )
    own = measured(voltage, current, sample_time)
    done = []
    for causal in (False, True):
        first = fluxobs.estimate(
            (voltage, current),
            machine,
            sample_time=sample_time,
            lag=-lag[0] + 0.0,
            causal=causal,
        )
        angle, known = np.array(first["theta_e"]), np.isfinite(first["theta_e"])
        rows = np.arange(len(angle))
        angle = np.interp(rows, rows[known], np.unwrap(angle[known]))
        learnt = {
            "resistance": np.log(max(first["resistance"][-1], 0.3 * machine.R_s)),
            "loss": np.log(max(first["inverter_voltage"][-1], 1e-3 * volts)),
        }
        if file.psi_f > 0:
            learnt["psi_f"] = np.log(max(first["psi_f"][-1], 0.3 * file.psi_f))
        for begin in ({},) if causal else (learnt, {}):
            with suppress(NoEstimate):
                done.append(estimate(voltage, own, sample_time, file, angle, begin))
    if not done:
        raise NoEstimate
    return min(done, key=lambda e: e.objective)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
