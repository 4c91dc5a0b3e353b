"""The text of machine files, with what a log told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .contract import Machine
from .rotating import RotatingMachine

#: What a parameter may change by until the next log, as a share of it: copper by heat, 40 K,
#: magnets by as much, an inverter by load and DC link.
CHANGES = {"R_s": 0.15, "R_R": 0.15, "psi_f": 0.05, "inverter_voltage": 0.1}


def with_found(
    machine: RotatingMachine, found: Mapping[str, tuple[float, float]]
) -> RotatingMachine:
    """The machine with values that were found, and what they may be off by next time.

    Parameters
    ----------
    machine : RotatingMachine
    found : mapping of str to (float, float)
        Name in the machine file → value and its standard deviation in this log.
    """
    known = machine.parameter_names()
    changes: dict[str, float] = {}
    for name, (value, std) in found.items():
        changes[name] = float(f"{value:.6g}")
        if f"{name}_std" in known:
            later = CHANGES.get(name, 0.0) * abs(value)
            changes[f"{name}_std"] = float(f"{(std**2 + later**2) ** 0.5:.2g}")
    return machine.with_values(**changes)


def machine_text(
    machine: Machine,
    head: Sequence[str],
    found: Mapping[str, tuple[float, float]],
    flux_map: str | None = None,
) -> str:
    """The text of a machine file: comment lines, then a parameter a line, with what was found.

    `flux_map` is its value in TOML, if it is not to be as the machine has it.
    """
    rows = [*(f"# {comment(line)}" for line in head), f'kind = "{machine.kind}"']
    values = {name: value for name, value in machine.parameters().items() if value is not None}
    stds = {name: values.pop(name) for name in list(values) if name.endswith("_std")}
    for name, value in values.items():
        if name != "flux_map":
            rows.append(f"{name} = {value!r}")
        else:
            rows.append(f"{name} = {value.text() if flux_map is None else flux_map}")
        if name in found:
            rows[-1] += f"  # ± {found[name][1]:.2g} in this log"
        if f"{name}_std" in stds:
            rows.append(f"{name}_std = {stds[f'{name}_std']!r}")
            if name in found and name in CHANGES:
                rows[-1] += f"  # and {CHANGES[name]:.0%} for heat until the next"
    return "\n".join(rows) + "\n"


def comment(line: str) -> str:
    """One line, whatever the name of a log that it quotes."""
    return "".join(c if c.isprintable() else " " for c in line)
