"""What an encoder says about the lag of the voltages.

The estimated angle with a wrong lag runs ahead of the true one or behind it, in proportion to the
speed, like an encoder with a delay. Zero and direction of an encoder are unknown, but its delay is
usually less than a sample.
"""

from __future__ import annotations

import numpy as np

from ..core.arrays import Array
from ..logs.log import Log
from ..machines import RotatingMachine
from ..machines.model.frames import wrap
from ..smoothing.record import SmoothedRecord
from .columns import is_position

#: Standard deviation of the delay of an encoder [samples]: most drives sample angle and currents
#: at one instant, some read the angle an interrupt earlier or later.
DELAY = 0.4
#: The same if the true angle is to be taken as given.
DELAY_AS_GIVEN = 0.1
#: Least standard deviation of an estimated angle [rad].
LEAST_ANGLE_STD = float(np.radians(1.0))
#: Least agreement of the angles, the length of their mean difference as a phasor: with less, the
#: number of pole pairs or the channel is wrong.
AGREES = 0.9


def delay_cost(
    record: SmoothedRecord, truth: Array | None, log: Log, machine: RotatingMachine
) -> float:
    """Return the negative logarithm of the probability of the encoder's delay, if there is one.

    Parameters
    ----------
    record : SmoothedRecord
    truth : (rows,) ndarray, optional
        The truth channel on the rows of the record.
    """
    if truth is None or log.true is None or not is_position(log, machine):
        return 0.0
    true = machine.true_position(log.true.channel, truth)
    theta, speed = record.outputs["theta_e"], record.outputs["speed_e"]
    std = np.maximum(record.outputs["theta_e_std"], LEAST_ANGLE_STD)
    good = record.known & np.isfinite(theta) & np.isfinite(true)
    if not good.any():
        return 0.0
    theta, true, turned = theta[good], true[good], speed[good] * log.sample_time
    std = std[good]
    weight = 1 / std**2
    best, difference = 0.0, np.zeros(0)
    for direction in (1.0, -1.0):
        error = theta - direction * true
        mean = np.sum(weight * np.exp(1j * error)) / weight.sum()
        if abs(mean) > best:
            best = float(abs(mean))
            difference = wrap(error - float(np.angle(mean)))
    if best < AGREES:
        return 0.0
    varied = turned - float(weight @ turned) / float(weight.sum())
    square = float(weight @ varied**2)
    if not square > 0:
        return 0.0
    delay = float((weight * varied) @ difference) / square
    # The estimates' own errors last: they may all have the sign of the speed.
    own = float((weight * np.abs(varied)) @ std) / square
    usual = DELAY if log.layout.fit_truth else DELAY_AS_GIVEN
    return float(0.5 * delay**2 / (usual**2 + own**2))
