"""Convert a motor's datasheet to parameters in SI units, per phase (star), with peak values.

Datasheets give resistances between two terminals, and poles instead of pole pairs. Datasheets
describe the magnets by the speed per volt of a hobby motor (KV), a voltage per speed (K_e) or a
torque per ampere (K_t), where each value is for a line or a phase, and peak or rms. With the magnet
flux ψ, the peak voltage between two terminals is √3 n_p ψ ω, and the torque is 3/2 n_p ψ î.
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
    "L_line_min": "H between two terminals, the smallest over a turn",
    "L_line_max": "H between two terminals, the largest over a turn",
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
#: Factor from each kind of voltage to the peak value of a phase.
VOLTAGES = {
    "line peak": 1 / math.sqrt(3),
    "line rms": math.sqrt(2 / 3),
    "phase peak": 1.0,
    "phase rms": math.sqrt(2),
}
#: Peak phase current per ampere of each kind of current in K_t. With block commutation two phases
#: conduct, and K_t [Nm/A] is the peak voltage between two terminals divided by the speed, √3 n_p ψ.
CURRENTS = {"peak": 1.0, "rms": math.sqrt(2), "dc": 2 / math.sqrt(3)}
_CHOICES = {"kv_of": VOLTAGES, "K_e_of": VOLTAGES, "K_t_of": CURRENTS}
_DEFAULTS = {"kv_of": "line peak", "K_e_of": "line rms", "K_t_of": "rms", "connection": "star"}
_RPM = 2 * math.pi / 60


def _check_positive(name: str, value: object) -> float:
    """Return a positive finite number as float; raise ValueError for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
        raise ValueError(f"{name} must be a positive number [{FIELDS[name]}], got {value!r}")
    return float(value)


def _take_choice(
    fields: dict[str, Any], name: str, choices: Mapping[str, Any], note: Callable[[str], Any]
) -> str:
    """Remove a field that allows only some values; return its value or the default."""
    choice = fields.pop(name, None)
    if choice is None:
        choice = _DEFAULTS[name]
        note(f"{name.removesuffix('_of')} counts as {choice} ({name} = '{choice}')")
    if choice not in choices:
        raise ValueError(f"{name}: {choice!r}{nearest(str(choice), choices)}")
    return str(choice)


def from_datasheet(
    fields: Mapping[str, Any],
    inductances: tuple[str, str],
    magnets: bool,
    note: Callable[[str], Any] = lambda text: None,
) -> dict[str, Any]:
    """Return fields of a machine file, with datasheet fields converted to parameters.

    Parameters
    ----------
    fields : mapping
    inductances : (str, str)
        Names of the kind's inductances along d and q.
    magnets : bool
    note : callable, optional
        Function that receives the text of each assumption.

    Raises
    ------
    ValueError
        A value is impossible, or two fields give the same quantity.
    """
    if not set(fields) & set(FIELDS):
        return dict(fields)
    parameters = {name: value for name, value in fields.items() if name not in FIELDS}
    sheet = {name: value for name, value in fields.items() if name in FIELDS}

    def store(name: str, value: float) -> None:
        if name in parameters:
            raise ValueError(f"{name} is given twice: directly and by the datasheet")
        parameters[name] = float(f"{value:.6g}")

    if "poles" in sheet:
        poles = _check_positive("poles", sheet.pop("poles"))
        if poles % 2:
            raise ValueError(f"poles must be even, got {poles:g}: n_p counts pairs")
        store("n_p", poles / 2)
        parameters["n_p"] = int(poles // 2)
    _convert_windings(sheet, inductances, magnets, store, note)
    for name, parameter, factor in (
        ("rated_current_rms", "rated_current", math.sqrt(2)),
        ("rated_speed_rpm", "rated_speed", _RPM),
    ):
        if name in sheet:
            store(parameter, factor * _check_positive(name, sheet.pop(name)))
    _convert_magnets(sheet, parameters, store, note, magnets)
    _convert_power(sheet, parameters, store, note, magnets)
    return parameters


def _convert_windings(
    sheet: dict[str, Any],
    inductances: tuple[str, str],
    magnets: bool,
    store: Callable[[str, float], None],
    note: Callable[[str], Any],
) -> None:
    """Store resistance and inductances; between two terminals lie two phases, in star or delta."""
    names = tuple(dict.fromkeys(inductances))
    if "R_line" in sheet and "R_phase" in sheet:
        raise ValueError("R_line and R_phase: give one of them")
    share = 1.0
    if "R_phase" in sheet or "L_phase" in sheet:
        connection = _take_choice(sheet, "connection", {"star": 1, "delta": 1}, note)
        share = 1.0 if connection == "star" else 1 / 3
    sheet.pop("connection", None)
    if "R_line" in sheet:
        store("R_s", _check_positive("R_line", sheet.pop("R_line")) / 2)
    if "R_phase" in sheet:
        store("R_s", share * _check_positive("R_phase", sheet.pop("R_phase")))
    for name, factor in (("L_line", 0.5), ("L_phase", share)):
        if name in sheet:
            value = factor * _check_positive(name, sheet.pop(name))
            for inductance in names:
                store(inductance, value)
            if len(names) > 1:
                note(f"{' and '.join(names)} are assumed equal: {name} is a single value")
    low, high = sheet.pop("L_line_min", None), sheet.pop("L_line_max", None)
    if (low is None) != (high is None):
        raise ValueError("L_line_min and L_line_max belong together: give both or neither")
    if low is None or high is None:
        return
    smaller, larger = sorted(
        (_check_positive("L_line_min", low) / 2, _check_positive("L_line_max", high) / 2)
    )
    if len(names) == 1:
        store(names[0], (smaller + larger) / 2)
        note(f"{names[0]} is half the mean of L_line_min and L_line_max")
        return
    L_d, L_q, reason = (
        (smaller, larger, "the magnets lie along d")
        if magnets
        else (larger, smaller, "iron lies along d")
    )
    store("L_d", L_d)
    store("L_q", L_q)
    note(f"L_d and L_q are half the inductances between terminals: {reason}")


def _convert_magnets(
    sheet: dict[str, Any],
    parameters: dict[str, Any],
    store: Callable[[str, float], None],
    note: Callable[[str], Any],
    magnets: bool,
) -> None:
    """Store psi_f from kv, K_e or K_t."""
    names = [name for name in ("kv", "K_e", "K_t") if name in sheet]
    if not names:
        for name in _CHOICES:
            sheet.pop(name, None)
        return
    if not magnets:
        raise ValueError(f"{names[0]}: this kind of machine has no magnets")
    if len(names) > 1:
        raise ValueError(f"{' and '.join(names)}: give one of them; each determines psi_f")
    n_p = parameters.get("n_p")
    if not isinstance(n_p, int) or n_p < 1:
        raise ValueError(f"{names[0]} needs n_p, the pole pairs, or poles")
    name = names[0]
    value = _check_positive(name, sheet.pop(name))
    quantity = _take_choice(sheet, f"{name}_of", _CHOICES[f"{name}_of"], note)
    if name == "kv":
        store("psi_f", VOLTAGES[quantity] / (value * _RPM * n_p))
    elif name == "K_e":
        store("psi_f", VOLTAGES[quantity] * value / (1000 * _RPM * n_p))
    else:
        store("psi_f", value / (1.5 * n_p * CURRENTS[quantity]))


def _convert_power(
    sheet: dict[str, Any],
    parameters: dict[str, Any],
    store: Callable[[str, float], None],
    note: Callable[[str], Any],
    magnets: bool,
) -> None:
    """Store the rated current from power and speed, unless the current is given."""
    if "rated_power" not in sheet:
        return
    power = _check_positive("rated_power", sheet.pop("rated_power"))
    speed, psi, n_p = parameters.get("rated_speed"), parameters.get("psi_f"), parameters.get("n_p")
    if "rated_current" not in parameters and not speed:
        note("rated_power is ignored: it needs rated_speed_rpm")
    if "rated_current" in parameters or not (magnets and speed and psi and n_p):
        return
    store("rated_current", power / speed / (1.5 * n_p * psi))
    note(
        f"rated_current, {parameters['rated_current']:.3g} A peak, is computed from psi_f and the "
        f"rated torque, {power / speed:.3g} Nm"
    )
