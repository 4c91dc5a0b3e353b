"""Parameters in C, as the compiled observer computed them from the machine, with all digits."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .. import _core
from ..machines import FluxPoints, RotatingMachine
from ..observers import AdaptiveObserver, LeastSquaresObserver
from .c_source import PRECISIONS, Precision, inert, initializer, literal

#: Type of a plain or adaptive observer, in one precision.
Exported = LeastSquaresObserver | AdaptiveObserver


#: Places of the asymmetry among the unknowns (FO_ASYMMETRY); the inductances follow.
ASYMMETRY = slice(6, 8)


def std_of(observer: AdaptiveObserver) -> list[float]:
    """Return the prior standard deviations of an export, without that of a known asymmetry."""
    std: list[float] = observer.parameters()["std"]
    return std if observer.asymmetry_std > 0 else [*std[: ASYMMETRY.start], *std[ASYMMETRY.stop :]]


def plain(observer: Exported) -> LeastSquaresObserver:
    """Return a plain observer itself, or the plain observer inside an adaptive observer."""
    return observer.plain if isinstance(observer, AdaptiveObserver) else observer


def isotropic(observer: LeastSquaresObserver) -> bool:
    """Whether all matrices are multiples of the identity and the relation has no linear terms."""
    c = observer.constraint
    matrices = (c.Q1, c.Q2, c.Q3, observer.R, observer.B)
    scalar = all(np.array_equal(matrix, matrix[0, 0] * np.eye(2)) for matrix in matrices)
    return scalar and not c.E.any() and not c.C.any()


def _adaptive_settings(o: AdaptiveObserver) -> dict[str, str]:
    return {
        "assumed magnet flux": f"{o.psi_f:.6g} +- {o.psi_f_std:.6g} Wb",
        "assumed resistance": f"{o.resistance:.6g} +- {o.resistance_std:.6g} ohm",
        "assumed inverter voltage": f"{o.inverter_voltage:.6g} +- {o.inverter_std:.6g} V",
        "inverter current": f"{o.inverter_current:.6g} A",
        "slow memory": f"{o.slow_memory:.6g} s",
        "projection": o.projection,
    }


def settings(observer: Exported, update_every: int) -> dict[str, str]:
    """Return the settings of the observer in SI units as texts, by name."""
    o, more, unknowns = plain(observer), {}, ["drift"]
    if isinstance(observer, AdaptiveObserver):
        more = _adaptive_settings(observer)
        unknowns += ["resistance"] if observer.resistance_std > 0 else []
        unknowns += ["inverter"] if observer.inverter_std > 0 else []
        unknowns += ["asymmetry"] if observer.asymmetry_std > 0 else []
    return more | {
        "interrupt every": f"{o.sample_time / update_every:.9g} s",
        "step every": f"{o.sample_time:.9g} s",
        "memory": f"{o.memory:.9g} s",
        "unknowns": ", ".join(unknowns),
        "current noise": f"{o.current_noise:.6g} A (std of a component)",
        "drift prior": f"{o.drift_prior:.6g} V (std)",
        "constraint noise": f"{o.constraint_noise:.6g} Wb^2 (std)",
        "current limit": f"{o.current_limit:.6g} A",
        "shortest position vector": f"{o.length_min:.6g} Wb",
        "tracker bandwidth": f"{o.tracker_bandwidth:.6g} rad/s",
    }


def bases(exported: Exported) -> dict[str, str]:
    """Return the bases of the per-unit system as texts, by name."""
    observer = plain(exported)
    psi, memory = observer.flux_base, observer.memory
    return {
        "flux": f"{psi:.9g} Wb",
        "time": f"{memory:.9g} s (the memory)",
        "drift": f"{psi / memory:.9g} V",
        "constraint": f"{psi**2:.9g} Wb^2",
    }


def digest(*texts: str) -> str:
    """Return sixteen hexadecimal digits that change with any of the texts."""
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:16]


def parameter_files(
    prefix: str,
    observer: Mapping[Precision, Exported],
    machine: RotatingMachine,
    version: str,
    sources: tuple[str, ...],
    update_every: int,
) -> tuple[str, dict[str, str]]:
    """Return the hash of the content, and the texts of the parameters' header and source.

    `observer` holds an observer for each precision; `sources` are the C sources for both.
    """
    single = observer["single"]
    facts = {
        "machine": parameters(machine),
        "settings": settings(single, update_every),
        "per-unit bases": bases(single),
    }
    about = "\n".join(
        f" *\n * {title}:\n" + "\n".join(f" *   {name} = {value}" for name, value in lines.items())
        for title, lines in facts.items()
    )
    constants = {
        precision: _initializers(observer[precision], precision, prefix) for precision in PRECISIONS
    }
    maps = {
        precision: _flux_map(observer[precision], precision, prefix) for precision in PRECISIONS
    }
    tables = (
        f"#if FO_SINGLE\n{maps['single']}\n#else\n{maps['double']}\n#endif\n\n"
        if maps["single"]
        else ""
    )
    adaptive = isinstance(single, AdaptiveObserver)
    kind, include = ("fo_adaptive", "fluxobs_adaptive") if adaptive else ("fo_observer", "fluxobs")
    guard = f"{prefix}_observer_h"  # include guards of the library end in a capital letter
    step = plain(single).sample_time
    declared = f"""\
#ifndef {guard}
#define {guard}

#include "{include}.h"

#ifdef __cplusplus
extern "C" {{
#endif

#if FO_SINGLE
#define {prefix}_observer {prefix}_observer_single
#endif

enum {{
    {prefix}_pole_pairs = {machine.n_p},
    {prefix}_update_every = {update_every} /* interrupts per step */
}};
/* Periods of the current-control interrupt and of a step [s]. */
#define {prefix}_sample_time ((fo_real){step / update_every:.9g})
#define {prefix}_step_time ((fo_real){step:.9g})

extern const {kind} {prefix}_observer;

#ifdef __cplusplus
}}
#endif

#endif
"""
    defined = f"""\
#include "{prefix}_observer.h"

{_needs(single)}{tables}/* Per-unit unless stated. Constant, in flash: needs no initialisation. */
const {kind} {prefix}_observer = {{
#if FO_SINGLE
{constants["single"]}
#else
{constants["double"]}
#endif
}};
"""
    content = digest(about, declared, defined, *sources)
    title = (
        f"/* Parameters of the fluxobs observer for {prefix}. Generated by fluxobs {version}.\n"
        f" * Content {content}: a hash of these parameters and the sources.\n"
    )
    return content, {
        f"{prefix}_observer.h": f"{title}{about}\n */\n{declared}",
        f"{prefix}_observer.c": f"{title} */\n{defined}",
    }


def _flux_map(observer: Exported, precision: Precision, prefix: str) -> str:
    """Return the flux map as C constants, or "" without a flux map."""
    flux_map = plain(observer).flux_map
    if flux_map is None:
        return ""
    fields = flux_map.core()
    table = np.asarray(fields.pop("coefficients"), float)
    name = f"{prefix}_map"
    text, pointer = "", "NULL"
    if table.size:
        rows = ",\n".join(
            "    " + ", ".join(literal(float(x), precision) for x in row)
            for row in table.reshape(table.shape[0], -1)
        )
        pointer = f"{name}_coefficients"
        text = (
            f"/* psi_d and psi_q over i_d (rows) and i_q: quadratic B-splines [Wb]. */\n"
            f"static const fo_real {pointer}[{table.size}] = {{\n{rows}\n}};\n\n"
        )
    kind = ("FO_MAP_LINEAR", "FO_MAP_TABLE", "FO_MAP_CAGE")[fields.pop("kind")]
    magnets = "true" if fields.pop("magnets") else "false"
    numbers = "".join(
        f"    {literal(float(value), precision)}, /* {key} */\n" for key, value in fields.items()
    )
    return (
        f"{text}static const fo_map {name} = {{\n    {kind}, {magnets}, {table.shape[0]}, "
        f"{table.shape[1]},\n{numbers}    {pointer},\n}};"
    )


def _initializers(observer: Exported, precision: Precision, prefix: str) -> str:
    """Return the parameters as C initialisers, one per line with its meaning."""

    def lines(values: Mapping[str, Any], meaning: Mapping[str, str]) -> str:
        return "\n".join(
            f"    {value if isinstance(value, str) else initializer(value, precision)}, "
            f"/* {meaning[name]} */"
            for name, value in values.items()
        )

    inner = lines(plain(observer).parameters(), _core.meanings)
    # Sources of this machine lack the flux map if the machine needs none (core.py). These
    # parameters may also be compiled with the sources of another machine, which may contain the
    # flux map.
    flux_map = "NULL" if plain(observer).flux_map is None else f"&{prefix}_map"
    inner += f"\n#if FO_MAPPED\n    {flux_map}, /* flux over current */\n#endif"
    if not isinstance(observer, AdaptiveObserver):
        return inner
    more = observer.parameters() | {"projection": f"FO_PROJECT_{observer.projection.upper()}"}
    std = [initializer(value, precision) for value in more["std"]]
    before, asymmetry, after = (
        ", ".join(numbers)
        for numbers in (std[: ASYMMETRY.start], std[ASYMMETRY], std[ASYMMETRY.stop :])
    )
    more["std"] = f"{{{before},\n#if FO_ASYMMETRIC\n    {asymmetry},\n#endif\n    {after}}}"
    return f"    {{\n{inner}\n    }},\n{lines(more, _core.adaptive_meanings)}"


def _needs(observer: Exported) -> str:
    """Return #error lines that refuse sources of another export without the needed features."""
    inner = plain(observer)
    asymmetric = isinstance(observer, AdaptiveObserver) and observer.asymmetry_std > 0
    needed = {
        "FO_MAPPED": (inner.flux_map is not None, 1),
        "FO_ASYMMETRIC": (asymmetric, 1),
        "FO_HELD": (inner.held > 0, 1),
        "FO_ISOTROPIC": (not isotropic(inner), 0),
    }
    return "".join(
        f'#if {name} != {value}\n#error "use the sources exported with these parameters: they have '
        f'{name} {value}"\n#endif\n\n'
        for name, (needs, value) in needed.items()
        if needs
    )


def parameters(machine: RotatingMachine) -> dict[str, str]:
    """Return the parameters of the machine with units as texts, by name."""
    units = {"R_s": "ohm", "n_p": "pole pairs", "psi_f": "Wb", "rated_current": "A"}
    units |= {"inverter_voltage": "V", "inverter_current": "A"}
    units |= {"R_R": "ohm", "psi_R": "Wb", "rated_speed": "rad/s"}
    values = {name: value for name, value in machine.parameters().items() if value is not None}
    flux_map = values.pop("flux_map", None)
    texts = {"kind": machine.kind} | {
        name: f"{value:.9g} {units.get(name.removesuffix('_std'), 'H')}"
        for name, value in values.items()
    }
    if flux_map is None:
        return texts
    path = flux_map.source if isinstance(flux_map, FluxPoints) else flux_map.text()
    return texts | {"flux_map": inert(Path(path).name)}
