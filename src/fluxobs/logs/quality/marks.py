"""The marks of a row: what each means, how it is found, and what an estimate does with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Mark:
    """A mark.

    Attributes
    ----------
    name : str
    bit : int
        Value in the column `quality`, a sum of marks; a mark of a phase has three bits.
    meaning, found, use : str
        What such a row means, how the detector finds it, and how an estimate treats it.
    fault : bool
        Whether the log is at fault; some marks are normal events.
    """

    name: str
    bit: int
    meaning: str
    found: str
    use: str
    fault: bool = True


MARKS = (
    Mark(
        "missing",
        1,
        "a current or the voltage has no value",
        "empty or not finite",
        "a current is bridged if the current turns by less than 3 rad; after a longer gap of the "
        "voltage the flux may jump",
    ),
    Mark(
        "repeated",
        2,
        "the logger wrote an earlier row again",
        "currents and voltages equal those of the row before bit by bit, which noise or rotation "
        "would not leave",
        "current and voltage are missing",
    ),
    Mark(
        "held",
        4,
        "the current is that of an earlier row, for example where a shunt cannot measure",
        "currents equal those of the row before bit by bit, the voltages do not",
        "the current is missing",
    ),
    Mark(
        "clipped",
        8,
        "a phase current is at the end of its converter or amplifier",
        "a phase stays within the resolution at its extreme, although it enters and leaves with a "
        "slope",
        "the current is missing",
    ),
    Mark(
        "out of range",
        16,
        "a current or voltage is impossibly large",
        "ten times the usual current, a hundred times the usual voltage",
        "the value is missing",
    ),
    Mark(
        "outlier",
        32,
        "one or two currents contradict their neighbours",
        "off its neighbours by a quarter of the usual current, and more than these differ",
        "the current is missing",
    ),
    Mark(
        "no current",
        64,
        "the bridge may be off",
        "|i| below 2 % of its usual size and noise for 20 rows",
        "if the voltages contradict the flux there, they are taken as unknown",
        fault=False,
    ),
    Mark(
        "bridge off",
        128,
        "no current flows, and the logged voltages are not those of the machine",
        "a log with these voltages does not fit; without them it does",
        "the voltage is unknown; the flux may jump, and the rows are not valid",
    ),
    Mark(
        "floating phase",
        256 | 512 | 1024,
        "block commutation: phase a (256), b (512) or c (1024) is switched off, and the log does "
        "not have its voltage",
        "the phase carries no current, and its voltage is 0, that of another phase, or the mean of "
        "the others; another phase follows",
        "its voltage is the back-EMF, from the voltage between the driven phases over a turn",
        fault=False,
    ),
    Mark(
        "injected",
        2048,
        "a high-frequency signal is injected",
        "above 0.15 of the sampling frequency, the mean power of the current is ten times that of "
        "noise with the median of its spectrum, and most of it is at one frequency, in 256 rows",
        "it does not count as noise, nor for the speed; in a salient machine it shows the "
        "direction of the rotor",
        fault=False,
    ),
)

(
    MISSING,
    REPEATED,
    HELD,
    CLIPPED,
    RANGE,
    OUTLIER,
    NO_CURRENT,
    BRIDGE_OFF,
    FLOATING,
    INJECTED,
) = (mark.bit for mark in MARKS)
#: Bits of the floating phases a, b and c.
FLOATING_BITS = (256, 512, 1024)
#: The current of a row with one of these marks is not a measurement.
NO_MEASUREMENT = MISSING | REPEATED | HELD | CLIPPED | RANGE | OUTLIER
FAULTS = sum(mark.bit for mark in MARKS if mark.fault)


def floating_of(quality: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the floating phase of each row: 1, 2, 3; 0 without."""
    phase = np.zeros(len(quality), np.int64)
    for n, bit in enumerate(FLOATING_BITS):
        phase[quality & bit > 0] = n + 1
    return phase


def with_floating(quality: NDArray[np.int64], phase: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the marks with those of the floating phase."""
    marked = quality & ~FLOATING
    for n, bit in enumerate(FLOATING_BITS):
        marked = marked + bit * (phase == n + 1)
    return np.asarray(marked)


def names_of(quality: int) -> list[str]:
    """Return the names of the marks in a value of the column `quality`."""
    return [mark.name for mark in MARKS if quality & mark.bit]
