"""Where the engine starts: courses and parameters of today's whole-log and causal estimates."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

import fluxobs
from engine.estimates import Estimate, NoEstimate, estimate, file_of
from engine.likelihood import Array, Complex
from fluxobs import InteriorPMSM, SurfacePMSM

Machine = SurfacePMSM | InteriorPMSM


def inductances(machine: Machine) -> tuple[float, float]:
    """Return L_d and L_q [H]."""
    if isinstance(machine, SurfacePMSM):
        return machine.L_s, machine.L_s
    return machine.L_d, machine.L_q


def started(
    voltage: Complex,
    current: Complex,
    sample_time: float,
    machine: Machine,
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
    assert machine.psi_f is not None
    volts = float(np.sqrt(np.nanmean(np.abs(voltage) ** 2)))
    file = file_of(
        *(machine.R_s, *inductances(machine), machine.psi_f, rated_current),
        lag=lag,
        voltage=volts if ordinary else None,
    )
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
            "psi_f": np.log(max(first["psi_f"][-1], 0.3 * machine.psi_f)),
            "loss": np.log(max(first["inverter_voltage"][-1], 1e-3 * volts)),
        }
        for begin in ({},) if causal else (learnt, {}):
            with suppress(NoEstimate):
                done.append(estimate(voltage, current, sample_time, file, angle, begin))
    if not done:
        raise NoEstimate
    return min(done, key=lambda e: e.objective)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
