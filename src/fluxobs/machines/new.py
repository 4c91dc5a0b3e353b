"""New machine files, from what a datasheet or a rating plate says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..core.validation import nearest
from ..errors import MachineError
from .datasheet import FIELDS, from_datasheet
from .file_text import machine_text
from .files import machine_from
from .induction import PLATE
from .registry import KINDS
from .rotating import RotatingMachine, rotating


@dataclass(frozen=True)
class New:
    """A machine, the first lines of its file, and what was assumed for it."""

    machine: RotatingMachine
    head: tuple[str, ...]
    assumed: tuple[str, ...]

    @property
    def text(self) -> str:
        """Of its file."""
        return machine_text(self.machine, self.head, {})


def new_machine(kind: str, fields: Mapping[str, Any]) -> New:
    """A machine from fields of a machine file, of a datasheet, or of an induction machine's plate.

    Parameters
    ----------
    kind : str
    fields : mapping
        Parameters, or the fields of :data:`fluxobs.machines.datasheet.FIELDS`; for an induction
        machine voltage, frequency, power, current, speed and cos_phi of its plate.

    Raises
    ------
    MachineError
        A field is missing, unknown or impossible.

    Examples
    --------
    >>> made = new_machine("surface-pmsm", {"poles": 14, "kv": 900, "R_line": 0.1, "L_line": 3e-5})
    >>> made.machine.n_p, made.machine.R_s, round(made.machine.psi_f, 6)
    (7, 0.05, 0.000875)
    """
    if kind not in KINDS or not issubclass(KINDS[kind], RotatingMachine):
        turning = [name for name, one in KINDS.items() if issubclass(one, RotatingMachine)]
        raise MachineError(f"kind {kind!r}{nearest(kind, turning)}")
    assumed: list[str] = []
    given = dict(fields)
    if kind == "induction" and set(given) & set(PLATE):
        given["plate"] = {name: given.pop(name) for name in PLATE if name in given}
        assumed.append("leakage is 0.15 of the rated impedance, and the winding is a star")
        assumed.append(
            "all losses but the rotor's are taken as in the stator winding, so R_s is at most this"
        )
    known = [*KINDS[kind].parameter_names(), *FIELDS, "plate", "R_r", "L_ls", "L_lr", "L_m"]
    for name in given:
        if name not in known:
            raise MachineError(f"unknown field {name!r}{nearest(name, known)}")
    _check_inductance(kind, given)
    machine = rotating(machine_from({"kind": kind, **given}, source="new machine"))
    from_datasheet(given, machine.inductances, machine.magnets, assumed.append)
    if machine.rated_current is None:
        assumed.append("rated_current is taken from each log; the firmware needs it")
    said = ", ".join(f"{name} = {value}" for name, value in fields.items())
    head = (f"Written by `fluxobs machine new` from {said}.", *assumed)
    return New(machine, head, tuple(assumed))


def _check_inductance(kind: str, given: Mapping[str, Any]) -> None:
    """A missing inductance, which many datasheets lack, gets a remedy of its own."""
    own = [name for name in KINDS[kind].parameter_names() if name.startswith("L_")]
    if kind == "induction" or "flux_map" in given:
        return
    if not {*own, "L_line", "L_line_min", "L_line_max", "L_phase"} & set(given):
        raise MachineError(
            "no inductance is given. Measure it between two terminals with an LCR meter (L_line, "
            "in H). To start with, L_line is R_line times 0.2 to 1 ms for a small motor, 2 to "
            "10 ms for a servo motor; then add L_s_std, half of L_s"
        )
