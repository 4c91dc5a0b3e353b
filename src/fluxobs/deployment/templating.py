"""Templates: text with @placeholders@, and with lines for only some kinds of export."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from importlib import resources

from ..machines import RotatingMachine
from ..observers import Estimate, outputs
from ..observers.thresholds import VOLTAGE_LIMIT
from .core import Core
from .costs import cost_table, read_costs, task_table
from .header import Exported, bases, parameters, settings
from .variables import ADAPTIVE, output_variables
from .vectors import COLUMNS


def fill(core: Core, template: str, more: Mapping[str, str] | None = None) -> str:
    """Return the text of a template such as ``c/README.md``, filled for this export.

    `more` are further placeholders and their values.
    """
    folder = resources.files(__package__) / "templates"
    text = _variant((folder / template).read_text(encoding="utf-8"), core)
    values = _placeholders(core) | dict(more or {})
    # All placeholders are replaced in one pass; placeholders within a value are kept.
    return re.sub(r"@(\w+)@", lambda match: values.get(match[1], match[0]), text)


def slowest_speed(core: Core) -> float:
    """Return the electrical speed [rad/s] above which voltage errors leave the position valid."""
    return core.plain.drift_prior / (VOLTAGE_LIMIT * core.plain.flux_base)


def _placeholders(core: Core) -> dict[str, str]:
    """Return the value of each @placeholder@ that all templates may use."""
    inner, machine, adaptive = core.plain, core.machine, core.adaptive
    costs = read_costs()["adaptive" if adaptive else "plain"]
    slowest = slowest_speed(core)
    compiled = [name for name in core.code if name.endswith(".c")]
    return {
        "prefix": core.prefix,
        "version": core.version,
        "sample_time": f"{inner.sample_time / core.update_every:.9g}",
        "step_time": f"{inner.sample_time:.9g}",
        "steps": "" if core.update_every == 1 else f" (a step in every {core.update_every}th)",
        "n_p": str(machine.n_p),
        "drift_prior": f"{inner.drift_prior:.3g}",
        "slowest": f"{slowest:.3g}",
        "flux": f"{inner.flux_base:.3g}",
        "ride": f"{1e3 * inner.flux_base / (2 * inner.drift_prior):.2g}",
        "slowest_rpm": f"{slowest / machine.n_p * 30 / math.pi:.3g}",
        "content": core.content,
        "psi_f_column": str(COLUMNS.index("psi_f")),
        "valid_column": str(COLUMNS.index("valid")),
        "angle_column": str(COLUMNS.index("theta_e")),
        "found": _compared_values(core),
        "outputs": _outputs_table(machine, adaptive),
        "columns": ", ".join(f'"{name}"' for name in COLUMNS),
        "costs": cost_table(costs),
        "tasks": task_table(read_costs()["tasks"]),
        "parameters": str(costs["parameters"]),
        "facts": _facts_table(machine, core.single, core.update_every),
        "fo": "fo_adaptive" if adaptive else "fo",
        "plain": ".plain" if adaptive else "",
        "position": ".position" if adaptive else "",
        "c_sources": " ".join(compiled),
        "runtime_sources": " ".join(
            [*(name for name in core.runtime if name.endswith(".c")), f"{core.prefix}_config.c"]
        ),
        "source_list": ", ".join(f"`{name}`" for name in core.sources),
        "header": "fluxobs_adaptive.h" if adaptive else "fluxobs.h",
    }


def _variant(template: str, core: Core) -> str:
    """Keep the lines for this observer: plain or adaptive, with one or more interrupts per step."""
    every = core.update_every
    marks = {"@every interrupt@": every == 1, "@every few@": every > 1}
    marks |= {"@when plain@": not core.adaptive, "@when adaptive@": core.adaptive}
    lines, keep = [], True
    for line in template.split("\n"):
        if line in marks or line == "@always@":
            keep = marks.get(line, True)
        elif keep:
            lines.append(line)
    return "\n".join(lines)


def _compared_values(core: Core) -> str:
    """Return the C expressions that test/check.c compares, in the order of the columns."""
    rows = (
        f"e.{output.member} ? (fo_real)1 : (fo_real)0," if output.boolean else f"e.{output.member},"
        for output in output_variables(core)[: len(COLUMNS)]
    )
    return "\n".join(f"            {row}" for row in rows)


def _outputs_table(machine: RotatingMachine, adaptive: bool) -> str:
    """Return the table of outputs as members of the C struct."""
    remarks = {"speed_e": f"; divide by {machine.n_p} for the shaft"}
    if machine.half_turn_ambiguous:
        remarks["theta_e"] = "; the opposite angle is equally possible"
    position = ".position" if adaptive else ""
    rows = [
        (
            f"`estimate{position}.{output.name}{'[2]' if output.vector else ''}`",
            "bool" if output.boolean else output.unit or "1",
            output.about.rstrip(".") + remarks.get(output.name, ""),
        )
        for output in outputs(Estimate)
    ]
    if adaptive:
        rows.append(("`estimate.psi_f`", "Wb", "Magnet flux (not the active flux)"))
        rows += [
            (f"`estimate.{more.member}`", "bool" if more.boolean else more.unit or "1", more.about)
            for more in ADAPTIVE
        ]
    return "\n".join(f"| {member} | {unit} | {about} |" for member, unit, about in rows)


def _facts_table(machine: RotatingMachine, observer: Exported, update_every: int) -> str:
    rows = {
        **parameters(machine),
        **settings(observer, update_every),
        **{f"per-unit base of {name}": value for name, value in bases(observer).items()},
    }
    lines = [f"| {name} | {value} |" for name, value in rows.items()]
    return "\n".join(["| | |", "|---|---|", *lines])
