"""Words for units, and what turns them into SI."""

from __future__ import annotations

import math
import re
from typing import Literal

from ..core.validation import nearest
from ..errors import RecordError

#: What a channel measures.
Quantity = Literal["time", "current", "voltage", "duty", "angle", "speed", "length"]

_PREFIXES = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "": 1.0, "k": 1e3}


def _prefixed(unit: str, prefixes: str, *words: str) -> dict[str, float]:
    found = {f"{p}{unit}": _PREFIXES[p] for p in [*prefixes, ""]}
    return found | dict.fromkeys(words, 1.0)


#: Unit → factor to SI, for each quantity; a word is compared as :func:`plain` writes it.
UNITS: dict[Quantity, dict[str, float]] = {
    "time": _prefixed("s", "num", "sec", "secs", "second", "seconds", "sek")
    | {"msec": 1e-3, "millisecond": 1e-3, "milliseconds": 1e-3}
    | {"usec": 1e-6, "microsecond": 1e-6, "microseconds": 1e-6, "nsec": 1e-9, "min": 60.0},
    "current": _prefixed("A", "umk", "a", "amp", "amps", "ampere", "amperes", "Amp", "Amps")
    | {"Ampere": 1.0, "ma": 1e-3},
    "voltage": _prefixed("V", "umk", "v", "volt", "volts", "Volt", "Volts") | {"mv": 1e-3},
    "duty": {"-1..1": 0.5, "%": 0.01, "percent": 0.01, "1": 1.0, "pu": 1.0, "p.u.": 1.0, "-": 1.0},
    "angle": {
        **_prefixed("rad", "m", "radian", "radians"),
        **dict.fromkeys(("deg", "degree", "degrees", "°"), math.pi / 180),
        **dict.fromkeys(("rev", "revs", "turn", "turns", "revolution", "revolutions"), math.tau),
    },
    "speed": {
        "rad/s": 1.0,
        "rads": 1.0,
        "rad/sec": 1.0,
        **dict.fromkeys(("rpm", "1/min", "min-1", "r/min", "rev/min", "u/min"), math.tau / 60),
        **dict.fromkeys(("rev/s", "turn/s", "turns/s", "rps", "1/s", "Hz", "hz"), math.tau),
        **dict.fromkeys(("deg/s", "°/s"), math.pi / 180),
        "krpm": 1e3 * math.tau / 60,
    },
    "length": {"m": 1.0, "mm": 1e-3, "um": 1e-6, "cm": 1e-2},
}
#: Units of a converter: a word, a colon, and a number. Counts are of a full scale: a turn, a duty
#: of one; ticks are of a clock [Hz].
COUNTS, TICKS = "counts", "ticks"
#: Fixed point with so many fractional bits: q8, q15, …
_FIXED = re.compile(r"^[qQ](\d{1,2})$")
_RAW_FULL: dict[Quantity, float] = {"angle": math.tau, "duty": 1.0}

_CHANNELS: tuple[tuple[str, Quantity], ...] = (
    ("i_", "current"),
    ("u", "voltage"),
    ("d_", "duty"),
    ("theta", "angle"),
    ("speed", "speed"),
    ("position", "length"),
    ("t", "time"),
)


def quantity(channel: str) -> Quantity | None:
    """What a channel measures; None for channels that have no unit, as Hall signals."""
    return next((found for start, found in _CHANNELS if channel.startswith(start)), None)


def plain(unit: str) -> str:
    """A unit as a person writes it → as the tables here have it."""
    word = unit.strip().strip("[](){}").strip().replace("µ", "u").replace("μ", "u")
    return word.replace("Â°", "°").replace("^-1", "-1").replace("⁻¹", "-1").replace(" ", "")


def known(unit: str) -> set[Quantity]:
    """The quantities that this unit may belong to."""
    word = plain(unit)
    if not word or word in ("1", "-"):
        return set()
    return {one for one, table in UNITS.items() if _in(table, word) is not None}


def _in(table: dict[str, float], word: str) -> float | None:
    """The factor of a unit; long words, and SI letters, in any case."""
    if word in table:
        return table[word]
    return table.get(word.lower()) if len(word) > 2 or word in ("S", "RAD") else None


def factor(channel: str, unit: str) -> float:
    """What turns a number in this unit into SI.

    Raises
    ------
    RecordError
        The unit is not known, or does not belong to such a channel.
    """
    kind, word = quantity(channel), plain(unit)
    if kind is None:
        raise RecordError(f"unit {channel}={unit}: the channel {channel} has no unit")
    if (found := _in(UNITS[kind], word)) is not None:
        return found
    if fixed := _FIXED.match(word):
        return 0.5 ** int(fixed[1])
    name, colon, size = word.partition(":")
    if colon and name in (COUNTS, TICKS):
        return _of_converter(channel, kind, name, size, unit)
    others = known(unit)
    words = f"unit {channel}={unit}: "
    if others:
        raise RecordError(f"{words}that is a unit of {' or '.join(sorted(others))}, not of {kind}")
    raise RecordError(f"{words}unknown unit{nearest(word, UNITS[kind])}")


def _of_converter(channel: str, kind: Quantity, name: str, size: str, unit: str) -> float:
    try:
        number = float(size)
    except ValueError:
        number = 0.0
    if not (math.isfinite(number) and number > 0):
        raise RecordError(f"unit {channel}={unit}: {size!r} is not a positive number")
    if name == TICKS and kind == "time":
        return 1.0 / number
    if name == COUNTS and kind in _RAW_FULL:
        return _RAW_FULL[kind] / number
    remedy = "ticks:HZ is for t, counts:FULL_SCALE for angles and duties; for currents and voltages"
    raise RecordError(f"unit {channel}={unit}: {remedy} give --adc {channel}=BITS,RANGE,ZERO")


def adc(channel: str, given: str) -> tuple[float, float]:
    """Scale and offset of a converter, from "bits,range,zero".

    The range [SI] is what all 2^bits counts span; the count at zero is half of them by default.

    Raises
    ------
    RecordError
        These are not two or three numbers, or impossible.
    """
    parts = [part.strip() for part in given.split(",")]
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    fits = len(numbers) in (2, 3) and all(map(math.isfinite, numbers))
    if not fits or not 1 <= numbers[0] <= 32 or numbers[0] % 1 or not numbers[1]:
        raise RecordError(
            f"adc {channel}={given}: expected BITS,RANGE or BITS,RANGE,ZERO: as 12,100,2048 for "
            f"12 bits that span 100 A, with zero at 2048 counts"
        )
    counts = 2.0 ** numbers[0]
    zero = numbers[2] if len(numbers) == 3 else counts / 2
    scale = numbers[1] / counts
    return scale, -scale * zero
