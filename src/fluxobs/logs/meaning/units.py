"""Names of units, and their factors to SI."""

from __future__ import annotations

import math
import re
from typing import Literal

from ...core.validation import nearest
from ...errors import RecordError

#: Physical quantity of a channel.
Quantity = Literal["time", "current", "voltage", "duty", "angle", "speed", "length"]

_PREFIXES = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "": 1.0, "k": 1e3}


def _prefixed(unit: str, prefixes: str, *synonyms: str) -> dict[str, float]:
    factors = {f"{prefix}{unit}": _PREFIXES[prefix] for prefix in [*prefixes, ""]}
    return factors | dict.fromkeys(synonyms, 1.0)


#: Unit → factor to SI, for each quantity; units are compared as :func:`plain` writes them.
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
#: Units of a converter, written with a colon and a number: counts per full scale (a turn, or a duty
#: of one), and ticks per second of a clock [Hz].
COUNTS, TICKS = "counts", "ticks"
#: Fixed point: q8 has 8 fractional bits, q15 has 15, …
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
    """Return the quantity of a channel, or None if it has no unit, such as a Hall signal."""
    return next((kind for prefix, kind in _CHANNELS if channel.startswith(prefix)), None)


def plain(unit: str) -> str:
    """Convert a unit, as people write it, to the spelling of the tables above."""
    text = unit.strip().strip("[](){}").strip().replace("µ", "u").replace("μ", "u")
    return text.replace("Â°", "°").replace("^-1", "-1").replace("⁻¹", "-1").replace(" ", "")


def known(unit: str) -> set[Quantity]:
    """Return the quantities that a unit may belong to."""
    word = plain(unit)
    if not word or word in ("1", "-"):
        return set()
    return {kind for kind, table in UNITS.items() if _table_factor(table, word) is not None}


def _table_factor(table: dict[str, float], word: str) -> float | None:
    """Return the factor of a unit; upper or lower case is ignored in long names, S and RAD."""
    if word in table:
        return table[word]
    return table.get(word.lower()) if len(word) > 2 or word in ("S", "RAD") else None


def factor(channel: str, unit: str) -> float:
    """Return the factor from a unit to SI.

    Raises
    ------
    RecordError
        The unit is unknown, or does not fit the channel.
    """
    kind, word = quantity(channel), plain(unit)
    if kind is None:
        raise RecordError(f"unit {channel}={unit}: the channel {channel} has no unit")
    if (scale := _table_factor(UNITS[kind], word)) is not None:
        return scale
    if fixed := _FIXED.match(word):
        return 0.5 ** int(fixed[1])
    name, colon, size = word.partition(":")
    if colon and name in (COUNTS, TICKS):
        return _converter_factor(channel, kind, name, size, unit)
    kinds = known(unit)
    where = f"unit {channel}={unit}: "
    if kinds:
        raise RecordError(f"{where}that is a unit of {' or '.join(sorted(kinds))}, not of {kind}")
    raise RecordError(f"{where}unknown unit{nearest(word, UNITS[kind])}")


def _converter_factor(channel: str, kind: Quantity, name: str, size: str, unit: str) -> float:
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
    raise RecordError(
        f"unit {channel}={unit}: ticks:HZ is for t, and counts:FULL_SCALE is for angles and "
        f"duties; for currents and voltages, give --adc {channel}=BITS,RANGE,ZERO"
    )


def adc(channel: str, given: str) -> tuple[float, float]:
    """Return (scale, offset) of a converter from "bits,range,zero".

    All 2^bits counts span the range [SI]; by default, the count at zero is half of all counts.

    Raises
    ------
    RecordError
        The text is not two or three numbers, or the numbers are impossible.
    """
    texts = [text.strip() for text in given.split(",")]
    try:
        numbers = [float(text) for text in texts]
    except ValueError:
        numbers = []
    valid = len(numbers) in (2, 3) and all(map(math.isfinite, numbers))
    if not valid or not 1 <= numbers[0] <= 32 or numbers[0] % 1 or not numbers[1]:
        raise RecordError(
            f"adc {channel}={given}: expected BITS,RANGE or BITS,RANGE,ZERO, such as 12,100,2048 "
            f"for 12 bits that span 100 A, with zero at 2048 counts"
        )
    counts = 2.0 ** numbers[0]
    zero = numbers[2] if len(numbers) == 3 else counts / 2
    scale = numbers[1] / counts
    return scale, -scale * zero
