"""What a datasheet says of a motor, as parameters: per phase (star), peak values, SI.

Datasheets give resistances between two terminals, poles instead of pole pairs, and the magnets as
the speed per volt of a hobby motor (KV), as a voltage per speed (K_e) or as a torque per ampere
(K_t); each of a line or a phase, peak or rms. With the flux ψ of the magnets, the peak voltage
between two terminals is √3 n_p ψ ω, and the torque 3/2 n_p ψ î.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from ..core.validation import nearest

#: Fields of a datasheet, with their units.
FIELDS = {
    "poles": "1",
    "R_line": "Ω between two terminals",
    "R_phase": "Ω of a winding",
    "L_line": "H between two terminals",
    "L_line_min": "H between two terminals, the least over a turn",
    "L_line_max": "H between two terminals, the most over a turn",
    "L_phase": "H of a winding",
    "connection": "star or delta, for R_phase and L_phase",
    "kv": "rpm/V",
    "kv_of": "line peak or line rms",
    "K_e": "V/krpm",
    "K_e_of": "line rms, line peak, phase rms or phase peak",
    "K_t": "Nm/A",
    "K_t_of": "rms, peak, or dc (per ampere of the DC link, with block commutation)",
    "rated_current_rms": "A",
    "rated_speed_rpm": "rpm",
    "rated_power": "W at the shaft",
}
#: Of what a voltage is → factor to the peak value of a phase.
VOLTAGES = {
    "line peak": 1 / math.sqrt(3),
    "line rms": math.sqrt(2 / 3),
    "phase peak": 1.0,
    "phase rms": math.sqrt(2),
}
#: Of what K_t's ampere is → its share of a peak phase current. With block commutation two phases
#: conduct, and K_t [Nm/A] is the peak voltage between two terminals over the speed, √3 n_p ψ.
CURRENTS = {"peak": 1.0, "rms": math.sqrt(2), "dc": 2 / math.sqrt(3)}
_OF = {"kv_of": VOLTAGES, "K_e_of": VOLTAGES, "K_t_of": CURRENTS}
_USUAL = {"kv_of": "line peak", "K_e_of": "line rms", "K_t_of": "rms", "connection": "star"}
_RPM = 2 * math.pi / 60


def _positive(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
        raise ValueError(f"{name} must be a positive number [{FIELDS[name]}], got {value!r}")
    return float(value)


def _word(
    given: dict[str, Any], name: str, known: Mapping[str, Any], say: Callable[[str], Any]
) -> str:
    word = given.pop(name, None)
    if word is None:
        word = _USUAL[name]
        say(f"{name.removesuffix('_of')} is taken as {word} ({name})")
    if word not in known:
        raise ValueError(f"{name}: {word!r}{nearest(str(word), known)}")
    return str(word)


def from_datasheet(
    fields: Mapping[str, Any],
    inductances: tuple[str, str],
    magnets: bool,
    say: Callable[[str], Any] = lambda text: None,
) -> dict[str, Any]:
    """Fields of a machine file, with those of a datasheet turned into its parameters.

    Parameters
    ----------
    fields : mapping
    inductances : (str, str)
        Names of the kind's inductances along d and q.
    magnets : bool
    say : callable, optional
        Called with what was assumed, in words.

    Raises
    ------
    ValueError
        A value is impossible, or two fields say the same thing.
    """
    given = dict(fields)
    if not set(given) & set(FIELDS):
        return given
    out = {name: value for name, value in given.items() if name not in FIELDS}
    given = {name: value for name, value in given.items() if name in FIELDS}

    def take(name: str, value: float) -> None:
        if name in out:
            raise ValueError(f"{name} is given twice: directly, and by the datasheet")
        out[name] = float(f"{value:.6g}")

    if "poles" in given:
        poles = _positive("poles", given.pop("poles"))
        if poles % 2:
            raise ValueError(f"poles must be even, got {poles:g}: n_p counts pairs")
        take("n_p", poles / 2)
        out["n_p"] = int(poles // 2)
    _windings(given, inductances, magnets, take, say)
    for name, own, factor in (
        ("rated_current_rms", "rated_current", math.sqrt(2)),
        ("rated_speed_rpm", "rated_speed", _RPM),
    ):
        if name in given:
            take(own, factor * _positive(name, given.pop(name)))
    _magnets(given, out, take, say, magnets)
    _power(given, out, take, say, magnets)
    return out


def _windings(
    given: dict[str, Any],
    inductances: tuple[str, str],
    magnets: bool,
    take: Callable[[str, float], None],
    say: Callable[[str], Any],
) -> None:
    """Resistance and inductances; between two terminals of star or delta there are two phases."""
    names = tuple(dict.fromkeys(inductances))
    if "R_line" in given and "R_phase" in given:
        raise ValueError("R_line and R_phase: give one of them")
    share = 1.0
    if "R_phase" in given or "L_phase" in given:
        connection = _word(given, "connection", {"star": 1, "delta": 1}, say)
        share = 1.0 if connection == "star" else 1 / 3
    given.pop("connection", None)
    if "R_line" in given:
        take("R_s", _positive("R_line", given.pop("R_line")) / 2)
    if "R_phase" in given:
        take("R_s", share * _positive("R_phase", given.pop("R_phase")))
    for name, factor in (("L_line", 0.5), ("L_phase", share)):
        if name in given:
            value = factor * _positive(name, given.pop(name))
            for own in names:
                take(own, value)
            if len(names) > 1:
                say(f"{' and '.join(names)} are taken as equal: {name} is only one number")
    low, high = given.pop("L_line_min", None), given.pop("L_line_max", None)
    if (low is None) != (high is None):
        raise ValueError("L_line_min and L_line_max belong together")
    if low is None or high is None:
        return
    least, most = sorted((_positive("L_line_min", low) / 2, _positive("L_line_max", high) / 2))
    if len(names) == 1:
        take(names[0], (least + most) / 2)
        say(f"{names[0]} is half of the mean of L_line_min and L_line_max")
        return
    d, q, why = (
        (least, most, "the magnets lie along d") if magnets else (most, least, "iron lies along d")
    )
    take("L_d", d)
    take("L_q", q)
    say(f"L_d and L_q are halves of the inductances between terminals: {why}")


def _magnets(
    given: dict[str, Any],
    out: dict[str, Any],
    take: Callable[[str, float], None],
    say: Callable[[str], Any],
    magnets: bool,
) -> None:
    named = [name for name in ("kv", "K_e", "K_t") if name in given]
    if not named:
        for name in _OF:
            given.pop(name, None)
        return
    if not magnets:
        raise ValueError(f"{named[0]}: this kind of machine has no magnets")
    if len(named) > 1:
        raise ValueError(f"{' and '.join(named)}: give one of them, the magnets have one flux")
    n_p = out.get("n_p")
    if not isinstance(n_p, int) or n_p < 1:
        raise ValueError(f"{named[0]} needs n_p, the pole pairs, or poles")
    name = named[0]
    value = _positive(name, given.pop(name))
    of = _word(given, f"{name}_of", _OF[f"{name}_of"], say)
    if name == "kv":
        take("psi_f", VOLTAGES[of] / (value * _RPM * n_p))
    elif name == "K_e":
        take("psi_f", VOLTAGES[of] * value / (1000 * _RPM * n_p))
    else:
        take("psi_f", value / (1.5 * n_p * CURRENTS[of]))


def _power(
    given: dict[str, Any],
    out: dict[str, Any],
    take: Callable[[str, float], None],
    say: Callable[[str], Any],
    magnets: bool,
) -> None:
    """The rated current from power and speed, if nothing else says it."""
    if "rated_power" not in given:
        return
    power = _positive("rated_power", given.pop("rated_power"))
    speed, psi, n_p = out.get("rated_speed"), out.get("psi_f"), out.get("n_p")
    if "rated_current" not in out and not speed:
        say("rated_power is of no use without rated_speed_rpm, and is left out")
    if "rated_current" in out or not (magnets and speed and psi and n_p):
        return
    take("rated_current", power / speed / (1.5 * n_p * psi))
    say(
        f"rated_current, {out['rated_current']:.3g} A peak, is what the rated torque, "
        f"{power / speed:.3g} Nm, needs of these magnets"
    )
