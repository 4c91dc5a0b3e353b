"""Templates: text with @words@, and lines that belong to some exports only."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from importlib import resources

from .. import _core
from ..machines import RotatingMachine
from ..observers import Estimate, outputs
from .core import Core
from .costs import cost_table, read_costs
from .header import Exported, bases, parameters, settings
from .variables import ADAPTIVE, output_variables
from .vectors import COLUMNS

#: Angle by which a voltage error as large as the drift's prior may turn the flux while the position
#: is valid [rad].
VOLTAGE_LIMIT: float = _core.thresholds["VOLTAGE_LIMIT"]


def fill(core: Core, template: str, more: Mapping[str, str] | None = None) -> str:
    """The text of a template, ``c/README.md``, with the words of this export and `more` of them."""
    folder = resources.files(__package__) / "templates"
    text = _variant((folder / template).read_text(encoding="utf-8"), core)
    values = words(core) | dict(more or {})
    # In one pass: what a value holds is no word.
    return re.sub(r"@(\w+)@", lambda word: values.get(word[1], word[0]), text)


def slowest_speed(core: Core) -> float:
    """Electrical speed above which the position is valid [rad/s], as far as voltage errors go."""
    return core.plain.drift_prior / (VOLTAGE_LIMIT * core.plain.flux_base)


def words(core: Core) -> dict[str, str]:
    """What templates call @word@."""
    inside, machine, adaptive = core.plain, core.machine, core.adaptive
    costs = read_costs()["adaptive" if adaptive else "plain"]
    slowest = slowest_speed(core)
    compiled = [name for name in core.code if name.endswith(".c")]
    return {
        "prefix": core.prefix,
        "version": core.version,
        "sample_time": f"{inside.sample_time / core.update_every:.9g}",
        "step_time": f"{inside.sample_time:.9g}",
        "steps": "" if core.update_every == 1 else f" (a step in every {core.update_every}th)",
        "n_p": str(machine.n_p),
        "drift_prior": f"{inside.drift_prior:.3g}",
        "slowest": f"{slowest:.3g}",
        "flux": f"{inside.flux_base:.3g}",
        "ride": f"{1e3 * inside.flux_base / (2 * inside.drift_prior):.2g}",
        "slowest_rpm": f"{slowest / machine.n_p * 30 / math.pi:.3g}",
        "content": core.content,
        "psi_f_column": str(COLUMNS.index("psi_f")),
        "valid_column": str(COLUMNS.index("valid")),
        "angle_column": str(COLUMNS.index("theta_e")),
        "found": _found(core),
        "outputs": _outputs(machine, adaptive),
        "columns": ", ".join(f'"{name}"' for name in COLUMNS),
        "costs": cost_table(costs),
        "parameters": str(costs["parameters"]),
        "facts": _facts(machine, core.single, core.update_every),
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
    """Keep the lines for an observer stepped every interrupt or every few, plain or adaptive."""
    every = core.update_every
    marks = {"@every interrupt@": every == 1, "@every few@": every > 1}
    marks |= {"@when plain@": not core.adaptive, "@when adaptive@": core.adaptive}
    kept, keep = [], True
    for line in template.split("\n"):
        if line in marks or line == "@always@":
            keep = marks.get(line, True)
        elif keep:
            kept.append(line)
    return "\n".join(kept)


def _found(core: Core) -> str:
    """The values that test/check.c compares, in the order of the columns."""
    rows = (
        f"e.{one.member} ? (fo_real)1 : (fo_real)0," if one.boolean else f"e.{one.member},"
        for one in output_variables(core)[: len(COLUMNS)]
    )
    return "\n".join(f"            {row}" for row in rows)


def _outputs(machine: RotatingMachine, adaptive: bool) -> str:
    """The table of outputs, from the one list, as members of the C struct."""
    more = {"speed_e": f"; divide by {machine.n_p} for the shaft"}
    if machine.half_turn_ambiguous:
        more["theta_e"] = "; the one 180 degrees away fits as well"
    position = ".position" if adaptive else ""
    rows = [
        (
            f"`estimate{position}.{one.name}{'[2]' if one.vector else ''}`",
            "bool" if one.boolean else one.unit or "1",
            one.about.rstrip(".") + more.get(one.name, ""),
        )
        for one in outputs(Estimate)
    ]
    if adaptive:
        rows.append(("`estimate.psi_f`", "Wb", "The magnet's flux (not the active one)"))
        rows += [
            (f"`estimate.{one.member}`", "bool" if one.boolean else one.unit or "1", one.about)
            for one in ADAPTIVE
        ]
    return "\n".join(f"| {member} | {unit} | {about} |" for member, unit, about in rows)


def _facts(machine: RotatingMachine, observer: Exported, update_every: int) -> str:
    rows = {
        **parameters(machine),
        **settings(observer, update_every),
        **{f"per-unit base of {name}": value for name, value in bases(observer).items()},
    }
    lines = [f"| {name} | {value} |" for name, value in rows.items()]
    return "\n".join(["| | |", "|---|---|", *lines])
