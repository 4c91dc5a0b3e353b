"""What the name of a column says: its channel, and its unit.

Names of tools and people differ in case, separators, the letter of a quantity (u or v), the names
of the phases (a b c, u v w, 1 2 3, L1 L2 L3) and in words such as `meas` or `ref`. A name is
reduced to letters and digits, and compared with one pattern a channel.
"""

from __future__ import annotations

import re
from functools import cache
from typing import NamedTuple

from .units import known, plain, quantity

_PHASES = {"a": "(?:a|u|1|l1)", "b": "(?:b|v|2|l2)", "c": "(?:c|w|3|l3)"}
#: The same for currents and voltages, which also have the phases R S T.
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
#: Words after a name that do not change what it is.
_MORE = (
    "(?:meas|measured|mes|m|fb|fbk|feedback|act|actual|filt|filtered|ref|cmd|command|set|setpoint"
    "|sp|star|soll|ist|target|demand|out|applied|n|0|s|phase|avg|mean|value|val|in)?"
)


_SETPOINT = re.compile("(?:ref|reference|cmd|command|set|setpoint|sp|star|soll|target|demand)$")


def is_setpoint(column: str) -> bool:
    """Whether the name of a column says that it is asked for, not measured."""
    parted = unit_in(column)
    return _SETPOINT.search(key(leaf(column if parted is None else parted[0]))) is not None


@cache
def _patterns() -> dict[str, re.Pattern[str]]:
    """One pattern a channel; made when the first name needs it."""
    found: dict[str, str] = {
        "t": "(?:t|time|times|timestamp|timestamps|zeit|temps|xaxis|xvalue|x|tout|elapsed"
        "|elapsedtime|relativetime|timesec|systemtime|datetime|date|clock|abstime)"
    }
    for letter, word, start in (("i", _CURRENT, "current"), ("u", _VOLTAGE, "voltage")):
        for phase, names in _RST.items():
            found[f"{letter}_{phase}"] = (
                f"(?:{word}{names}{_MORE}|(?:phase|ph)?{names}(?:phase)?{start}{_MORE}"
                f"|(?:phase|ph){names}{letter}{_MORE})"
            )
        for axis, names in _AXES.items():
            found[f"{letter}_{axis}"] = (
                f"(?:{word}{names}{_MORE}|{names}(?:axis)?{word}{_MORE}|{word}{_MORE}{names})"
            )
    for pair, names in _PAIRS.items():
        found[f"u_{pair}"] = f"(?:{_VOLTAGE}{names}{_MORE}|{_VOLTAGE}line{names})"
    for phase, names in _PHASES.items():
        found[f"d_{phase}"] = f"(?:{_DUTY}{names}|{_DUTY}phase{names}|(?:phase)?{names}duty)"
        found[f"hall_{phase}"] = f"(?:hall{names}|h{names}|hallsensor{names})"
    found["udc"] = (
        "(?:[uv]dc|[uv]_?bus|busvoltage|[uv]dclink|dclink|dclinkvoltage|dcbus|dcbusvoltage"
        "|dcvoltage|[uv]in|inputvoltage|[uv]zk|supplyvoltage|supply|[uv]batt?|[uv]motor|[uv]d?cbus"
        "|[uv]dcmeas|vsupply)"
    )
    found["theta_e"] = (
        f"(?:{_ANGLE}{_ELECTRICAL}|{_ELECTRICAL}{_ANGLE}|{_ELECTRICAL}(?:rotor)?{_ANGLE}"
        f"|{_ELECTRICAL}phase|{_ANGLE}{_ELECTRICAL}rad)"
    )
    found["theta_mech"] = (
        f"(?:{_ANGLE}{_MECHANICAL}|{_MECHANICAL}{_ANGLE}|encoder|enc|encoderangle|{_ANGLE}estimate"
        f"|encoderposition|shaftangle|angmes)"
    )
    found["theta"] = f"(?:{_ANGLE}|rotor{_ANGLE}|theta0)"
    found["speed_e"] = f"(?:{_SPEED}{_ELECTRICAL}|{_ELECTRICAL}{_SPEED}|erpm|felec|fe)"
    found["speed_mech"] = (
        f"(?:{_SPEED}{_MECHANICAL}?|{_MECHANICAL}{_SPEED}|rpm|n|nmech|speedrpm|motorspeed|drehzahl"
        f"|nrpm|velestimate)"
    )
    found["hall"] = "(?:hall|halls|hallstate|hallcode)"
    found["sin"] = "(?:sin|sine|encsin|sinenc|encodersin|resolversin|ressin|ssin|sinus)"
    found["cos"] = "(?:cos|cosine|enccos|cosenc|encodercos|resolvercos|rescos|scos|cosinus)"
    return {channel: re.compile(f"^{words}$") for channel, words in found.items()}


_LETTERS = str.maketrans({"α": "alpha", "β": "beta", "θ": "theta", "ω": "omega", "φ": "phi"})
#: "Ia [mA]", "Ia (mA)", "Ia {mA}", "Ia / mA", "Ia, mA", "Ia in mA".
_BRACKETS = re.compile(r"^(.*?)\s*[\[({]\s*([^\[\](){}]*)\s*[\])}]\s*(.*)$")
_BEHIND = re.compile(r"^(.*?)(?:\s*/\s*|\s*,\s*|\s+in\s+|\s+)([^\s/,]+)$")
#: Ends of paths that say nothing.
_PORT = re.compile(r"^(out|in|value|values|data|signal)\d*$", re.IGNORECASE)
#: "in s", and "CH1V", as instruments write them.
_IN, _SCOPE = re.compile(r"^()in\s+(\S+)$"), re.compile(r"^(CH\s?\d+)\s*([VA])$")
#: "u_a_V", "theta_deg", "time-ms", "Ia.mA".
_JOINED = re.compile(r"^(.*)[_\-.]([^_\-.]+)$")


class Named(NamedTuple):
    """What a name says."""

    channel: str | None
    unit: str | None = None


def leaf(column: str) -> str:
    """The last part of a path such as "group/current/i_a" that says something."""
    parts = column.split("/")
    while len(parts) > 1 and _PORT.match(parts[-1].strip()):
        parts.pop()
    return parts[-1]


def key(name: str) -> str:
    """A name reduced to what is compared."""
    return re.sub(r"[^a-z0-9]", "", name.lower().translate(_LETTERS))


def _match(name: str) -> str | None:
    word = key(name)
    return next((one for one, pattern in _patterns().items() if pattern.match(word)), None)


def _fits(channel: str | None, unit: str) -> bool:
    """Whether a channel may have the unit."""
    if channel is None:
        return False
    kind = quantity(channel)
    return kind is not None and kind in known(unit)


def unit_in(column: str) -> tuple[str, str] | None:
    """A name without its unit, and the unit, if it has one in brackets or behind a slash."""
    name = leaf(column) if "/" not in column or column.count("/") > 1 else column
    for pattern in (_BRACKETS, _IN, _SCOPE, _BEHIND):
        found = pattern.match(name.strip())
        if found and known(found[2]):
            tail = found[3] if pattern is _BRACKETS else ""
            return f"{found[1]} {tail}".strip(), plain(found[2])
    return None


def read_name(column: str) -> Named:
    """Channel and unit that a column's name says."""
    name, parted = leaf(column), unit_in(column)
    group, _, last = column.rpartition("/")
    if group and len(last) == 1:  # "voltages/a": a phase, not amperes
        return Named(_match(f"{leaf(group)}_{last}"))
    if parted is not None and (_BRACKETS.match(name) or _match(name) is None):
        return Named(_match(leaf(parted[0])), parted[1])
    bare = _BRACKETS.match(name)  # "Current (phase A)"
    channel = _match(name) or (_match(bare[1]) if bare else None)
    if channel is not None:
        return Named(channel, "rpm" if channel == "speed_mech" and "rpm" in key(name) else None)
    joined = _JOINED.match(name)
    if joined:
        stem = _match(joined[1])
        if _fits(stem, joined[2]) or (stem == "theta" and "angle" in known(joined[2])):
            return Named(stem, plain(joined[2]))
    nested = name.rsplit(".", 1)[-1]
    return read_name(nested) if nested != name else Named(None)
