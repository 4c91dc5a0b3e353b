"""Rotor resistance of a cage from its slip, for logs with the mechanical speed."""

from __future__ import annotations

import numpy as np

from ..errors import FluxobsError
from ..logs.log import Log
from ..logs.scales import excerpts
from ..machines import RotatingMachine
from ..observers.for_log import plain_for

#: Number of blocks of rows whose scatter gives the standard deviation.
BLOCKS = 24
#: Rows are used if |i_q| exceeds this share of the rated (if unknown, the largest) current.
LOADED = 0.1


def resistance_from_speed(log: Log, machine: RotatingMachine) -> tuple[float, float]:
    """Return R_R and its standard deviation [Ω], from ``ω_x - n_p ω_m = R_R i_q/|x|``.

    The log's truth is the mechanical speed [rad/s]. The plain observer gives the speed and length
    of the rotor flux x; a line through the origin is fitted to the valid rows.

    Raises
    ------
    FluxobsError
        Too few rows have a position, a speed and a load.
    """
    observer, scales = plain_for(log, machine)
    smallest_load = LOADED * (machine.rated_current or scales.current)
    slips, loads = [], []
    for excerpt in excerpts(log):
        assert excerpt.truth is not None
        estimate = observer.run(excerpt.voltage, excerpt.current)
        i = (excerpt.current @ [1, 1j]) * np.exp(-1j * estimate.theta_e)
        usable = estimate.valid & np.isfinite(excerpt.truth) & (np.abs(i.imag) > smallest_load)
        slips.append((estimate.speed_e - machine.n_p * excerpt.truth)[usable])
        loads.append((i.imag / estimate.psi_f)[usable])
    slip, load = np.concatenate(slips), np.concatenate(loads)
    if len(slip) < 10 * BLOCKS:
        raise FluxobsError(
            f"{log.path}: the position is known on {len(slip)} rows with a speed and a load, too "
            f"few to identify R_R from the slip"
        )
    cross = np.array([block.sum() for block in np.array_split(slip * load, BLOCKS)])
    square = np.array([block.sum() for block in np.array_split(load**2, BLOCKS)])
    value = float(cross.sum() / square.sum())
    # The standard deviation follows from the scatter of the blocks about the line.
    deviation = cross - value * square
    std = float(np.sqrt(np.sum(deviation**2) * BLOCKS / (BLOCKS - 1)) / square.sum())
    return value, std
