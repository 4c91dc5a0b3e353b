"""The text of machine files, with identified parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .contract import Machine
from .rotating import RotatingMachine

#: Expected change of a parameter until the next log, as a share of its value. Copper and magnets
#: change with 40 K of heat, an inverter with load and DC link.
CHANGES = {"R_s": 0.15, "R_R": 0.15, "psi_f": 0.05, "inverter_voltage": 0.1}


def with_found(
    machine: RotatingMachine, found: Mapping[str, tuple[float, float]]
) -> RotatingMachine:
    """Return the machine with identified values, and their standard deviations for the next log.

    Parameters
    ----------
    machine : RotatingMachine
    found : mapping of str to (float, float)
        Value and its standard deviation in this log, by the name in the machine file.
    """
    names = machine.parameter_names()
    values: dict[str, float] = {}
    for name, (value, std) in found.items():
        values[name] = float(f"{value:.6g}")
        if f"{name}_std" in names:
            change = CHANGES.get(name, 0.0) * abs(value)
            values[f"{name}_std"] = float(f"{(std**2 + change**2) ** 0.5:.2g}")
    return machine.with_values(**values)


def machine_text(
    machine: Machine,
    head: Sequence[str],
    found: Mapping[str, tuple[float, float]],
    flux_map: str | None = None,
) -> str:
    """Return the text of a machine file: comment lines, then one parameter per line.

    Comments mark the identified values, `found`, with their standard deviations. `flux_map` is TOML
    that replaces the machine's value of this field.
    """
    lines = [*(f"# {comment(line)}" for line in head), f'kind = "{machine.kind}"']
    values = {name: value for name, value in machine.parameters().items() if value is not None}
    stds = {name: values.pop(name) for name in list(values) if name.endswith("_std")}
    for name, value in values.items():
        if name != "flux_map":
            lines.append(f"{name} = {value!r}")
        else:
            lines.append(f"{name} = {value.text() if flux_map is None else flux_map}")
        if name in found:
            lines[-1] += f"  # ± {found[name][1]:.2g} in this log"
        if f"{name}_std" in stds:
            lines.append(f"{name}_std = {stds[f'{name}_std']!r}")
            if name in found and name in CHANGES:
                lines[-1] += f"  # includes {CHANGES[name]:.0%} for changes until the next log"
    return "\n".join(lines) + "\n"


def comment(line: str) -> str:
    """Return one line of a comment, with unprintable characters replaced by spaces."""
    return "".join(c if c.isprintable() else " " for c in line)
