"""The contents of an exported folder."""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib import metadata, resources

from .. import _core
from ..errors import FluxobsError
from ..machines import RotatingMachine
from ..observers import AdaptiveObserver, Estimate, outputs
from ..synthetic.firmware_record import firmware_record
from .c_source import Precision
from .costs import cost_table, read_costs
from .header import Exported, bases, parameter_files, parameters, plain, settings
from .vectors import COLUMNS, run, vectors_header

SOURCES = ("fluxobs_real.h", "fluxobs.h", "fluxobs_internal.h", "fluxobs.c")
#: Needed only by a machine with a flux map.
MAP_SOURCES = ("fluxobs_map.h", "fluxobs_map.c")
ADAPTIVE_SOURCES = (
    *SOURCES,
    *(
        f"fluxobs_{part}.{kind}"
        for part in ("adaptive", "learning", "candidates", "triangle")
        for kind in ("h", "c")
    ),
)
#: What an export changes in the sources if the asymmetry is not an unknown: it saves memory and
#: time, and changes no number.
ASYMMETRIC = "#define FO_ASYMMETRIC 1"
#: What it changes if the machine needs no flux map, for the same reasons.
MAPPED = "#define FO_MAPPED 1"
#: What it changes so that the folder itself chooses single precision: build systems such as the
#: Arduino IDE have no options for a library.
DOUBLE = "#define FO_SINGLE 0"
#: Angle by which a voltage error as large as the drift's prior may turn the flux while the position
#: is valid [rad].
VOLTAGE_LIMIT: float = _core.thresholds["VOLTAGE_LIMIT"]


def contents(
    prefix: str,
    machine: RotatingMachine,
    observers: Mapping[Precision, Exported],
    update_every: int,
) -> tuple[str, dict[str, str]]:
    """Hash of the content, and the files: relative path → text."""
    version = metadata.version("fluxobs")
    installed = resources.files("fluxobs") / "firmware"
    adaptive = isinstance(observers["single"], AdaptiveObserver)
    mapped = plain(observers["single"]).flux_map is not None
    names = (ADAPTIVE_SOURCES if adaptive else SOURCES) + (MAP_SOURCES if mapped else ())
    sources = {name: (installed / name).read_text(encoding="utf-8") for name in names}
    single = observers["single"]
    _choose(sources, DOUBLE, 1)
    if isinstance(single, AdaptiveObserver) and not single.asymmetry_std > 0:
        _choose(sources, ASYMMETRIC, 0)
    if not mapped:
        _choose(sources, MAPPED, 0)
    texts = tuple(sources.values())
    content, headers = parameter_files(prefix, observers, machine, version, texts, update_every)
    inside = plain(single)
    record = firmware_record(machine, inside, _unsure(single, machine))
    estimates = {p: run(observer, record, update_every) for p, observer in observers.items()}
    if not estimates["single"].valid.any():
        raise FluxobsError(
            f"with these settings the position is never known, not even at full speed: memory "
            f"{inside.memory:g} s, current noise {inside.current_noise:g} A, drift prior "
            f"{inside.drift_prior:g} V; check the units of R_s, inductance and rated_current"
        )
    costs = read_costs()["adaptive" if adaptive else "plain"]
    slowest = inside.drift_prior / (VOLTAGE_LIMIT * inside.flux_base)
    words = {
        "prefix": prefix,
        "sample_time": f"{inside.sample_time / update_every:.9g}",
        "step_time": f"{inside.sample_time:.9g}",
        "steps": "" if update_every == 1 else f" (a step in every {update_every}th)",
        "n_p": str(machine.n_p),
        "drift_prior": f"{inside.drift_prior:.3g}",
        "slowest": f"{slowest:.3g}",
        "flux": f"{inside.flux_base:.3g}",
        "ride": f"{1e3 * inside.flux_base / (2 * inside.drift_prior):.2g}",
        "slowest_rpm": f"{slowest / machine.n_p * 30 / math.pi:.3g}",
        "content": content,
        "psi_f_column": str(COLUMNS.index("psi_f")),
        "valid_column": str(COLUMNS.index("valid")),
        "angle_column": str(COLUMNS.index("theta_e")),
        "found": _found(adaptive),
        "outputs": _outputs(machine, adaptive),
        "columns": ", ".join(f'"{name}"' for name in COLUMNS),
        "costs": cost_table(costs),
        "parameters": str(costs["parameters"]),
        "facts": _facts(machine, observers["single"], update_every),
        "fo": "fo_adaptive" if adaptive else "fo",
        "plain": ".plain" if adaptive else "",
        "position": ".position" if adaptive else "",
        "c_sources": " ".join(
            [*(name for name in names if name.endswith(".c")), f"{prefix}_observer.c"]
        ),
        "source_list": ", ".join(f"`{name}`" for name in names),
        "header": "fluxobs_adaptive.h" if adaptive else "fluxobs.h",
    }
    folder = resources.files(__package__) / "templates"

    def filled(name: str) -> str:
        template = (folder / name).read_text(encoding="utf-8")
        text = _variant(template, update_every, adaptive)
        for word, value in words.items():
            text = text.replace(f"@{word}@", value)
        return text

    return content, sources | {
        "LICENSE": (installed / "LICENSE").read_text(encoding="utf-8"),
        **headers,
        "README.md": filled("README.md"),
        "Makefile": filled("Makefile"),
        "example_isr.c": filled("example_isr.c"),
        "telemetry.h": filled("telemetry.h"),
        "telemetry.c": filled("telemetry.c"),
        "test/check.h": filled("check.h"),
        "test/check.c": filled("check.c"),
        "test/host_test.c": filled("host_test.c"),
        "test/vectors.h": vectors_header(record, estimates),
    }


def _choose(sources: dict[str, str], line: str, value: int) -> None:
    """Replace the value in a line ``#define NAME value`` of fluxobs_real.h."""
    text = sources["fluxobs_real.h"]
    assert text.count(line) == 1
    sources["fluxobs_real.h"] = text.replace(line, f"{line[:-1]}{value}")


def _unsure(observer: Exported, machine: RotatingMachine) -> float:
    """Voltage by which resistance and inverter may be off at the rated current [V]."""
    if not isinstance(observer, AdaptiveObserver):
        return 0.0
    resistance = observer.resistance_std * (machine.rated_current or 0.0)
    return math.hypot(resistance, 2 * observer.inverter_std)


def _variant(template: str, update_every: int, adaptive: bool) -> str:
    """Keep the lines for an observer stepped every interrupt or every few, plain or adaptive."""
    marks = {"@every interrupt@": update_every == 1, "@every few@": update_every > 1}
    marks |= {"@when plain@": not adaptive, "@when adaptive@": adaptive}
    kept, keep = [], True
    for line in template.split("\n"):
        if line in marks or line == "@always@":
            keep = marks.get(line, True)
        elif keep:
            kept.append(line)
    return "\n".join(kept)


def _member(name: str, adaptive: bool) -> str:
    """An output as a member of the estimate; the adaptive observer has its own magnet flux."""
    inner = adaptive and name.partition("[")[0] != "psi_f"
    return f".position.{name}" if inner else f".{name}"


def _found(adaptive: bool) -> str:
    """The values that test/check.c compares, in the order of the columns."""
    values = {name: f"e{_member(name, adaptive)}" for name in COLUMNS}
    values["valid"] += " ? (fo_real)1 : (fo_real)0"
    return "\n".join(f"            {value}," for value in values.values())


#: What the adaptive observer adds: members, unit, meaning.
_ADAPTIVE_OUTPUTS = (
    ("`estimate.psi_f`, `psi_f_std`", "Wb", "the magnet's flux (not the active one)"),
    ("`estimate.resistance_error`, `resistance_std`", "ohm", "true minus assumed"),
    ("`estimate.inverter_voltage`, `inverter_std`", "V", "dead time and device drops of a phase"),
    ("`estimate.drift_std`", "V", "standard deviation of a component of the drift"),
    (
        "`estimate.theta_other`, `weight_other`",
        "rad, 1",
        "while two angles are in question, the other one and its weight",
    ),
    ("`estimate.adapting`", "bool", "the filter for all of these runs"),
)


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
    rows += _ADAPTIVE_OUTPUTS if adaptive else ()
    return "\n".join(f"| {member} | {unit} | {about} |" for member, unit, about in rows)


def _facts(machine: RotatingMachine, observer: Exported, update_every: int) -> str:
    rows = {
        **parameters(machine),
        **settings(observer, update_every),
        **{f"per-unit base of {name}": value for name, value in bases(observer).items()},
    }
    lines = [f"| {name} | {value} |" for name, value in rows.items()]
    return "\n".join(["| | |", "|---|---|", *lines])
