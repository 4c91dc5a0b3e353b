"""Sample time, rate and start in the headers of files."""

from __future__ import annotations

import re

from ..meaning.units import UNITS, plain


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


INTERVAL = _words(
    "sampleinterval samplinginterval sampletime samplingtime samplingperiod sampleperiod "
    "timeinterval interval xincrement xincr xinc increment deltax deltat dt hresolution tinc "
    "timeincrement resolution timestep stepsize ts cycletime taskcycle horizinterval tinterval "
    "clock"
)
RATE = _words("samplerate samplingrate samplingfrequency samplefrequency fs rate samplespersecond")
START = _words("t0 xorigin x0 xorg hoffset xzero firstx start timeoffset horizoffset tstart")
#: A value with a unit, such as "1.0e-6 s", "2 MS/s" or "10kHz".
_VALUE_UNIT = re.compile(r"^([-+]?[\d.,]+(?:[eE][-+]?\d+)?)\s*([a-zA-Zµμ/]*)$")
_RATES = {"": 1.0, "hz": 1.0, "khz": 1e3, "mhz": 1e6, "ghz": 1e9}
_RATES |= {"sa/s": 1.0, "ksa/s": 1e3, "msa/s": 1e6, "gsa/s": 1e9}
_RATES |= {"s/s": 1.0, "ks/s": 1e3, "ms/s": 1e6, "gs/s": 1e9, "sps": 1.0, "ksps": 1e3}


def seconds_from(value: str, name: str) -> float | None:
    """Return a time [s] from its text; the unit follows the value, or is in brackets in `name`."""
    match = _VALUE_UNIT.match(value.strip())
    if not match:
        return None
    unit = plain(match[2]) or _unit_in_brackets(name) or "s"
    factor = UNITS["time"].get(unit) or UNITS["time"].get(unit.lower())
    return None if factor is None else _number(match[1]) * factor


def interval_from(value: str, name: str) -> float | None:
    """Return a sample time [s] from its text, or None if the sample time is not positive."""
    interval = seconds_from(value, name)
    return interval if interval is not None and interval > 0 else None


def rate_from(value: str, name: str) -> float | None:
    """Return a sample rate [Hz] from its text."""
    match = _VALUE_UNIT.match(value.strip())
    if not match:
        return None
    factor = _RATES.get((match[2] or _unit_in_brackets(name)).lower())
    number = _number(match[1])
    return number * factor if factor is not None and number > 0 else None


def _unit_in_brackets(name: str) -> str:
    match = re.search(r"[\[(]([^\[()\]]*)[\])]", name)
    return plain(match[1]) if match else ""


def _number(text: str) -> float:
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return 0.0
