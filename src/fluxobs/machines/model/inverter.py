"""The inverter's voltage error: dead time and device drops oppose each phase current."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ... import _core
from ...core.arrays import Array
from .frames import clarke

#: Below this share of the current's scale, the sign of a phase current is smoothed, because near
#: zero the switches' capacitances, not the dead time, determine the voltage.
SMOOTHING: float = _core.usual["SMOOTHING"]


def soft_sign(x: Array) -> Array:
    """Return tanh(x) to within 0.0014, as in C: a Padé approximant clipped where it reaches ±1."""
    x = np.clip(x, -3.6466, 3.6466)
    square = x**2
    return np.asarray(x * (945 + square * (105 + square)) / (945 + square * (420 + 15 * square)))


def inverter_direction(current: Array, threshold: float) -> Array:
    """Return the sum of the phase axes weighted by the smoothed current signs, (rows, 2).

    Dead time and device drops act along this direction: with V_d per phase, the inverter loses
    ``V_d · direction``. The smoothed sign reaches three quarters at the current `threshold` [A].
    """
    alpha, beta = current.T
    half, root = alpha / 2, np.sqrt(3) / 2 * beta
    return clarke(*(soft_sign(phase / threshold) for phase in (alpha, root - half, -root - half)))


@dataclass(frozen=True)
class InverterError:
    """The voltage that an inverter loses.

    Parameters
    ----------
    voltage : float
        V_d: voltage lost to dead time and device drops per phase [V].
    current : float
        Phase current at which the smoothed sign reaches three quarters [A].
    """

    voltage: float
    current: float

    def lost(self, before: Array, now: Array) -> Array:
        """Return the mean voltage lost over intervals, (rows, 2) [V].

        `before` and `now` are the currents at start and end; if a current is missing, the loss is
        zero.
        """
        direction = inverter_direction((before + now) / 2, self.current)
        return self.voltage * np.nan_to_num(direction)
