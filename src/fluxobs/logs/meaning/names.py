"""Find the channel and the unit in the name of a column.

Names differ in case, separators, letters (u or v for voltage), phase names (a b c, u v w, 1 2 3,
L1 L2 L3) and suffixes such as `meas` or `ref`. A name is reduced to letters and digits, and then
compared with one pattern per channel.
"""

from __future__ import annotations

import re
from functools import cache
from typing import NamedTuple

from .units import known, plain, quantity

_PHASES = {"a": "(?:a|u|1|l1)", "b": "(?:b|v|2|l2)", "c": "(?:c|w|3|l3)"}
#: Names of the phases of currents and voltages, which may also be R S T.
_RST = {"a": "(?:a|u|1|l1|r)", "b": "(?:b|v|2|l2|s)", "c": "(?:c|w|3|l3|t)"}
_PAIRS = {
    "ab": "(?:ab|uv|12|l12|l1l2|rs)",
    "bc": "(?:bc|vw|23|l23|l2l3|st)",
    "ca": "(?:ca|wu|31|l31|l3l1|tr)",
}
_AXES = {"alpha": "(?:alpha|alfa|alph|al)", "beta": "(?:beta|bet|be)", "d": "d", "q": "q"}
_CURRENT = (
    "(?:i|iabc|currents|is|im|iph|imot|imotor|iphase|iinv|cur|curr|current|currents?phase|(?:stator|motor)?phasecurrents?|strom|amps"
    "|statorcurrent|motorcurrent)"
)
_VOLTAGE = (
    "(?:u|v|uabc|vabc|us|vs|um|vm|uph|vph|uphase|vphase|uinv|vinv|volt|volts|voltages?|voltagephase"
    "|(?:stator|motor)?phasevoltages?|spannung|statorvoltage|motorvoltage)"
)
_DUTY = "(?:d|duty|duties|dutycycle|dc|pwm|pwmduty|m|modulation|dutyphase)"
_ANGLE = "(?:theta|angle|phi|rho|pos|position|ang|angmes|winkel)"
_SPEED = "(?:speed|omega|w|velocity|vel|velmes|spd)"
_MECHANICAL = "(?:m|mec|mech|mechanical|r|rotor|shaft|enc|encoder|motor|meas|mes|measured|mot)"
_ELECTRICAL = "(?:e|el|ele|elec|electric|electrical)"
_SENSOR = "(?:enc|encoder|resolver)"
#: Words after a name that do not change its channel.
_SUFFIX = (
    "(?:meas|measured|mes|m|fb|fbk|feedback|act|actual|filt|filtered|ref|cmd|command|set|setpoint"
    "|sp|star|soll|ist|target|demand|out|applied|n|0|s|phase|avg|mean|value|val|in)?"
)


_SETPOINT = re.compile("(?:ref|reference|cmd|command|set|setpoint|sp|star|soll|target|demand)$")


def is_setpoint(column: str) -> bool:
    """Return whether the name of a column means a setpoint, not a measurement."""
    split = unit_in(column)
    return _SETPOINT.search(key(leaf(column if split is None else split[0]))) is not None


@cache
def _patterns() -> dict[str, re.Pattern[str]]:
    """Return one pattern per channel; the patterns are built at the first call."""
    patterns: dict[str, str] = {
        "t": "(?:t|time|times|timestamp|timestamps|zeit|temps|xaxis|xvalue|x|tout|elapsed"
        "|elapsedtime|relativetime|timesec|systemtime|datetime|date|clock|abstime)"
    }
    for letter, words, stem in (
        ("i", _CURRENT, "current"),
        ("u", _VOLTAGE, "voltage"),
    ):
        for phase, names in _RST.items():
            patterns[f"{letter}_{phase}"] = (
                f"(?:{words}{names}{_SUFFIX}|(?:phase|ph)?{names}(?:phase)?{stem}{_SUFFIX}"
                f"|(?:phase|ph){names}{letter}{_SUFFIX})"
            )
        for axis, names in _AXES.items():
            patterns[f"{letter}_{axis}"] = (
                f"(?:{words}{names}{_SUFFIX}|{names}(?:axis)?{words}{_SUFFIX}|{words}{_SUFFIX}{names})"
            )
    for pair, names in _PAIRS.items():
        patterns[f"u_{pair}"] = f"(?:{_VOLTAGE}{names}{_SUFFIX}|{_VOLTAGE}line{names})"
    for phase, names in _PHASES.items():
        patterns[f"d_{phase}"] = f"(?:{_DUTY}{names}|{_DUTY}phase{names}|(?:phase)?{names}duty)"
        patterns[f"hall_{phase}"] = f"(?:hall{names}|h{names}|hallsensor{names})"
    patterns["udc"] = (
        "(?:[uv]dc|[uv]_?bus|busvoltage|[uv]dclink|dclink|dclinkvoltage|dcbus|dcbusvoltage"
        "|dcvoltage|[uv]in|inputvoltage|[uv]zk|supplyvoltage|supply|[uv]batt?|[uv]motor|[uv]d?cbus"
        "|[uv]dcmeas|vsupply)"
    )
    patterns["theta_e"] = (
        f"(?:{_ANGLE}{_ELECTRICAL}|{_ELECTRICAL}{_ANGLE}|{_ELECTRICAL}(?:rotor)?{_ANGLE}"
        f"|{_ELECTRICAL}phase|{_ANGLE}{_ELECTRICAL}rad|{_SENSOR}(?:{_ANGLE})?{_ELECTRICAL}"
        f"|{_ELECTRICAL}{_SENSOR})"
    )
    patterns["theta_mech"] = (
        f"(?:{_ANGLE}{_MECHANICAL}|{_MECHANICAL}{_ANGLE}|encoder|enc|encoderangle|{_ANGLE}estimate"
        f"|encoderposition|shaftangle|angmes|{_SENSOR}(?:mech|mechanical))"
    )
    patterns["theta"] = f"(?:{_ANGLE}|rotor{_ANGLE}|theta0)"
    patterns["speed_e"] = f"(?:{_SPEED}{_ELECTRICAL}|{_ELECTRICAL}{_SPEED}|erpm|felec|fe)"
    patterns["speed_mech"] = (
        f"(?:{_SPEED}{_MECHANICAL}?|{_MECHANICAL}{_SPEED}|rpm|n|nmech|speedrpm|motorspeed|drehzahl"
        f"|nrpm|velestimate)"
    )
    patterns["hall"] = "(?:hall|halls|hallstate|hallcode)"
    patterns["sin"] = "(?:sin|sine|encsin|sinenc|encodersin|resolversin|ressin|ssin|sinus)"
    patterns["cos"] = "(?:cos|cosine|enccos|cosenc|encodercos|resolvercos|rescos|scos|cosinus)"
    return {channel: re.compile(f"^{pattern}$") for channel, pattern in patterns.items()}


_LETTERS = str.maketrans({"α": "alpha", "β": "beta", "θ": "theta", "ω": "omega", "φ": "phi"})
#: Names with a unit in brackets: "Ia [mA]", "Ia (mA)", "Ia {mA}". Names with a unit after a
#: separator: "Ia / mA", "Ia, mA", "Ia in mA".
_BRACKETS = re.compile(r"^(.*?)\s*[\[({]\s*([^\[\](){}]*)\s*[\])}]\s*(.*)$")
_BEHIND = re.compile(r"^(.*?)(?:\s*/\s*|\s*,\s*|\s+in\s+|\s+)([^\s/,]+)$")
#: Last elements of a path that have no meaning.
_PORT = re.compile(r"^(out|in|value|values|data|signal)\d*$", re.IGNORECASE)
#: Names that instruments write, such as "in s" and "CH1V".
_IN, _SCOPE = re.compile(r"^()in\s+(\S+)$"), re.compile(r"^(CH\s?\d+)\s*([VA])$")
#: Names with a joined unit, such as "u_a_V", "theta_deg", "time-ms", "Ia.mA".
_JOINED = re.compile(r"^(.*)[_\-.]([^_\-.]+)$")


class Named(NamedTuple):
    """Channel and unit found in a name."""

    channel: str | None
    unit: str | None = None


def leaf(column: str) -> str:
    """Return the last meaningful element of a path such as "group/current/i_a"."""
    parts = column.split("/")
    while len(parts) > 1 and _PORT.match(parts[-1].strip()):
        parts.pop()
    return parts[-1]


def key(name: str) -> str:
    """Reduce a name to lower-case letters and digits."""
    return re.sub(r"[^a-z0-9]", "", name.lower().translate(_LETTERS))


def _match(name: str) -> str | None:
    reduced = key(name)
    return next(
        (channel for channel, pattern in _patterns().items() if pattern.match(reduced)), None
    )


def _phase(name: str, unit: str) -> str | None:
    """Return the channel of a phase that is named by its letter alone: "U [V]", "A [A]"."""
    reduced = key(name)
    letters = (n for n, names in _PHASES.items() if re.compile(f"^{names}$").match(reduced))
    letter = next(letters, None)
    if letter is None or reduced in "123":
        return None
    return next((f"{q}_{letter}" for q in ("u", "i") if _fits(f"{q}_{letter}", unit)), None)


def _fits(channel: str | None, unit: str) -> bool:
    """Return whether a channel may have the unit."""
    if channel is None:
        return False
    kind = quantity(channel)
    return kind is not None and kind in known(unit)


def unit_in(column: str) -> tuple[str, str] | None:
    """Split a name into name and unit, if a unit follows in brackets or after a separator."""
    name = leaf(column) if "/" not in column or column.count("/") > 1 else column
    for pattern in (_BRACKETS, _IN, _SCOPE, _BEHIND):
        match = pattern.match(name.strip())
        if match and known(match[2]):
            tail = match[3] if pattern is _BRACKETS else ""
            return f"{match[1]} {tail}".strip(), plain(match[2])
    return None


def read_name(column: str) -> Named:
    """Return the channel and unit in a column's name."""
    name, split = leaf(column), unit_in(column)
    group, _, member = column.rpartition("/")
    if group and len(member) == 1:  # in "voltages/a", the letter is a phase, not amperes
        return Named(_match(f"{leaf(group)}_{member}"))
    if split is not None and (_BRACKETS.match(name) or _match(name) is None):
        channel = _match(leaf(split[0]))
        if not _fits(channel, split[1]):
            channel = _phase(*split) or channel
        return Named(channel, split[1])
    bare = _BRACKETS.match(name)  # "Current (phase A)"
    channel = _match(name) or (_match(bare[1]) if bare else None)
    if channel is not None:
        return Named(channel, "rpm" if channel == "speed_mech" and "rpm" in key(name) else None)
    match = _JOINED.match(name)
    if match:
        stem = _match(match[1])
        if _fits(stem, match[2]) or (stem == "theta" and "angle" in known(match[2])):
            return Named(stem, plain(match[2]))
    tail = name.rsplit(".", 1)[-1]
    return read_name(tail) if tail != name else Named(None)
