"""New machine files from a datasheet or a rating plate."""

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
class NewMachine:
    """A machine, the first lines of its file, and how its parameters follow from the fields.

    Attributes
    ----------
    machine : RotatingMachine
    head : tuple of str
    assumed : tuple of str
        Assumptions.
    computed : dict
        Parameters that were not given themselves, with their values in SI.
    """

    machine: RotatingMachine
    head: tuple[str, ...]
    assumed: tuple[str, ...]
    computed: dict[str, float]

    @property
    def text(self) -> str:
        """Text of its file."""
        return machine_text(self.machine, self.head, {})


def new_machine(kind: str, fields: Mapping[str, Any]) -> NewMachine:
    """Create a machine from fields of a machine file, a datasheet or an induction machine's plate.

    Parameters
    ----------
    kind : str
    fields : mapping
        Parameters, or the fields of :data:`fluxobs.machines.datasheet.FIELDS`; for an induction
        machine also voltage, frequency, power, current, speed and cos_phi of its plate.

    Raises
    ------
    MachineError
        A field is missing, unknown or impossible.

    Examples
    --------
    >>> sheet = {"poles": 14, "kv": 900, "R_line": 0.1, "L_line": 3e-5}
    >>> machine = new_machine("surface-pmsm", sheet).machine
    >>> machine.n_p, machine.R_s, round(machine.psi_f, 6)
    (7, 0.05, 0.000875)
    """
    if kind not in KINDS or not issubclass(KINDS[kind], RotatingMachine):
        kinds = [name for name, cls in KINDS.items() if issubclass(cls, RotatingMachine)]
        raise MachineError(f"kind {kind!r}{nearest(kind, kinds)}")
    assumed: list[str] = []
    values = dict(fields)
    if kind == "induction" and set(values) & set(PLATE):
        values["plate"] = {name: values.pop(name) for name in PLATE if name in values}
        assumed.append(
            "assumed: a leakage reactance of 0.15 of the rated impedance, and a star winding"
        )
        assumed.append(
            "all losses but the rotor's are assigned to the stator winding: R_s is an upper bound"
        )
    names = [*KINDS[kind].parameter_names(), *FIELDS, "plate", "R_r", "L_ls", "L_lr", "L_m"]
    for name in values:
        if name in ("R", "L"):
            raise MachineError(
                f"{name} is measured between two terminals or of a phase? Give {name}_line="
                f"{values[name]} or {name}_phase={values[name]}; most datasheets state {name}_line"
            )
        if name not in names:
            raise MachineError(f"unknown field {name!r}{nearest(name, names)}")
    _check_inductance(kind, values)
    machine = rotating(machine_from({"kind": kind, **values}, source="new machine"))
    from_datasheet(values, machine.inductances, machine.magnets, assumed.append)
    if machine.rated_current is None:
        assumed.append("rated_current is not given: each log determines it, but an export needs it")
    source = ", ".join(f"{name} = {value}" for name, value in fields.items())
    head = (f"Written by `fluxobs machine new` from {source}.", *assumed)
    computed = {
        name: float(value)
        for name, value in machine.parameters().items()
        if name not in fields and isinstance(value, int | float)
    }
    return NewMachine(machine, head, tuple(assumed), computed)


def _check_inductance(kind: str, values: Mapping[str, Any]) -> None:
    """Raise MachineError with a remedy if no inductance is given, as in many datasheets."""
    inductances = [name for name in KINDS[kind].parameter_names() if name.startswith("L_")]
    if kind == "induction" or "flux_map" in values:
        return
    if not {*inductances, "L_line", "L_line_min", "L_line_max", "L_phase"} & set(values):
        raise MachineError(
            "no inductance is given. Measure it between two terminals with an LCR meter (L_line, "
            "in H). A first guess of L_line is R_line times 0.2 to 1 ms for a small motor, 2 to "
            "10 ms for a servo motor; then also give L_s_std, half of L_s"
        )
