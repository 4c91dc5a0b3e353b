"""The inverter's voltage error: dead time and device drops, which oppose each phase current."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ... import _core
from ...core.arrays import Array
from .frames import clarke

#: The sign of a phase current is smoothed below this share of the current's size: near zero, the
#: switches' capacitances determine the voltage, not the dead time.
SMOOTHING: float = _core.usual["SMOOTHING"]


def soft_sign(x: Array) -> Array:
    """tanh(x) to within 0.0014: its Padé approximant, clipped where it reaches ±1; as in C."""
    x = np.clip(x, -3.6466, 3.6466)
    square = x**2
    return np.asarray(x * (945 + square * (105 + square)) / (945 + square * (420 + 15 * square)))


def inverter_direction(current: Array, threshold: float) -> Array:
    """Sum of the phase axes weighted by the smoothed signs of the phase currents, (rows, 2).

    Dead time and device drops act along it: with V_d per phase, the voltage ``V_d · direction`` is
    lost. `threshold` [A] is the current at which the smoothed sign reaches three quarters.
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
        V_d: dead time and device drops of a phase [V].
    current : float
        Phase current at which the smoothed sign reaches three quarters [A].
    """

    voltage: float
    current: float

    def lost(self, before: Array, now: Array) -> Array:
        """Mean voltage lost over intervals, from the currents at start and end, (rows, 2) [V].

        Zero where a current is missing.
        """
        direction = inverter_direction((before + now) / 2, self.current)
        return self.voltage * np.nan_to_num(direction)
