"""Rotor resistance of a cage from its slip, where a log has the mechanical speed."""

from __future__ import annotations

import numpy as np

from ..errors import FluxobsError
from ..logs.log import Log
from ..logs.scales import excerpts
from ..machines import RotatingMachine
from ..observers.for_log import plain_for

#: Stretches whose scatter gives the standard deviation.
STRETCHES = 24
#: Rows that tell: |i_q| of at least this share of the rated or largest current.
LOADED = 0.1


def resistance_from_speed(log: Log, machine: RotatingMachine) -> tuple[float, float]:
    """R_R and its standard deviation [Ω], from ``ω_x - n_p ω_m = R_R i_q/|x|``.

    The log's truth is the mechanical speed [rad/s]. Speed and length of the rotor flux x are the
    plain observer's, on its valid rows; a line through the origin is laid through them.

    Raises
    ------
    FluxobsError
        The position is known on hardly any row that has a speed and a load.
    """
    observer, scales = plain_for(log, machine)
    least = LOADED * (machine.rated_current or scales.current)
    slips, loads = [], []
    for part in excerpts(log):
        assert part.truth is not None
        found = observer.run(part.voltage, part.current)
        i = (part.current @ [1, 1j]) * np.exp(-1j * found.theta_e)
        good = found.valid & np.isfinite(part.truth) & (np.abs(i.imag) > least)
        slips.append((found.speed_e - machine.n_p * part.truth)[good])
        loads.append((i.imag / found.psi_f)[good])
    slip, load = np.concatenate(slips), np.concatenate(loads)
    if len(slip) < 10 * STRETCHES:
        raise FluxobsError(
            f"{log.path}: the position is known on {len(slip)} rows with a speed and a load, too "
            f"few to tell R_R from the slip"
        )
    cross = np.array([part.sum() for part in np.array_split(slip * load, STRETCHES)])
    square = np.array([part.sum() for part in np.array_split(load**2, STRETCHES)])
    value = float(cross.sum() / square.sum())
    # the scatter of the stretches about the line
    off = cross - value * square
    std = float(np.sqrt(np.sum(off**2) * STRETCHES / (STRETCHES - 1)) / square.sum())
    return value, std
