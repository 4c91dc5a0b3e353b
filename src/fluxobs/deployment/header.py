"""The parameter header: what the compiled observer computed from the machine, digit for digit."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

from ..machines import RotatingMachine
from ..observers import AdaptiveObserver, LeastSquaresObserver
from .c_source import PRECISIONS, Precision, initializer

#: What the parameters are, in the order of fo_observer; a name that is missing here is an error.
MEANING = {
    "Q1x2": "2 Q1",
    "E": "linear term of the constraint",
    "row_Q2": "output row from the current, over noise [1/A]",
    "row_Q3": "[1/A^2]",
    "row_C": "[1/A]",
    "row_s": "1 / noise",
    "hR": "24ths of current to volt-seconds",
    "hB": "voltage to volt-seconds",
    "h": "sample time / memory",
    "rho": "forgetting a sample",
    "reinject": "share of the prior re-injected in a turn",
    "plausible": "std of the drift before anything is known",
    "noise_information": "what current noise alone pretends, a sample",
    "flux_base": "[Wb]",
    "drift_base": "[V]",
    "current_limit": "[A]",
    "over_noise": "1 / what noise makes of third differences [1/A^2]",
    "square_min": "of a position vector that tells",
    "L_position": "per ampere",
    "position_noise": "variance of x from the current's noise",
    "sample_time": "[s]",
    "track": "gains of the tracker",
}
#: The same of fo_adaptive, after the observer in it.
ADAPTIVE_MEANING = {
    "saliency": "L_d - L_q, per ampere",
    "mean": "of flux, drift, magnet flux, resistance error [ohm], inverter [V] at the start",
    "variance": "of these",
    "walk": "variance won in a round of turns",
    "noise": "variance of the residual",
    "through_R": "noise of the current in the flux, in a round",
    "decoy": "current noise in a sample's flux per ohm",
    "charge": "24 times a mean current to its integral",
    "over_current": "of the inverter [1/A]",
    "knee": "variance per V^2 where the inverter's sign is not sure",
    "projection": "when the information is projected",
}
#: Either observer, in one precision.
Exported = LeastSquaresObserver | AdaptiveObserver


def plain(observer: Exported) -> LeastSquaresObserver:
    """The observer itself, or the one in it."""
    return observer.plain if isinstance(observer, AdaptiveObserver) else observer


def _adaptive_settings(o: AdaptiveObserver) -> dict[str, str]:
    return {
        "magnet flux believed": f"{o.psi_f:.6g} +- {o.psi_f_std:.6g} Wb",
        "resistance believed": f"{o.resistance:.6g} +- {o.resistance_std:.6g} ohm",
        "inverter believed": f"{o.inverter_voltage:.6g} +- {o.inverter_std:.6g} V",
        "inverter current": f"{o.inverter_current:.6g} A",
        "slow memory": f"{o.slow_memory:.6g} s",
        "projection": o.projection,
    }


def settings(observer: Exported, update_every: int) -> dict[str, str]:
    """What was chosen for the observer, in SI units."""
    o, more, unknowns = plain(observer), {}, ["drift"]
    if isinstance(observer, AdaptiveObserver):
        more = _adaptive_settings(observer)
        unknowns += ["resistance"] if observer.resistance_std > 0 else []
        unknowns += ["inverter"] if observer.inverter_std > 0 else []
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
    """Bases of the per-unit system."""
    observer = plain(exported)
    psi, memory = observer.flux_base, observer.memory
    return {
        "flux": f"{psi:.9g} Wb",
        "time": f"{memory:.9g} s (the memory)",
        "drift": f"{psi / memory:.9g} V",
        "constraint": f"{psi**2:.9g} Wb^2",
    }


def digest(*texts: str) -> str:
    """Sixteen hexadecimal digits that change when any of the texts does."""
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:16]


def parameter_header(
    prefix: str,
    observer: Mapping[Precision, Exported],
    machine: RotatingMachine,
    version: str,
    sources: tuple[str, ...],
    update_every: int,
) -> tuple[str, str]:
    """Hash of the content, and the header's text.

    `observer` in either precision, `sources` what they belong to.
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
        precision: _initializers(observer[precision], precision) for precision in PRECISIONS
    }
    adaptive = isinstance(single, AdaptiveObserver)
    kind, include = ("fo_adaptive", "fluxobs_adaptive") if adaptive else ("fo_observer", "fluxobs")
    guard = f"FLUXOBS_{prefix}_H"
    body = f"""\
#ifndef {guard}
#define {guard}

#include "{include}.h"

/* Interrupts of the current control from one step of the observer to the next. */
enum {{ {prefix}_update_every = {update_every} }};

/* Per-unit unless said. Lives in flash: nothing has to be prepared when the drive starts. */
static const {kind} {prefix}_observer = {{
#ifdef FO_SINGLE
{constants["single"]}
#else
{constants["double"]}
#endif
}};

#endif
"""
    content = digest(about, body, *sources)
    text = (
        f"/* Parameters of the fluxobs observer for {prefix}. Generated by fluxobs {version}.\n"
        f" * Content {content}, of these parameters and of the sources.\n"
        f"{about}\n */\n{body}"
    )
    return content, text


def _initializers(observer: Exported, precision: Precision) -> str:
    """Every number, a line each with its meaning."""

    def lines(values: Mapping[str, Any], meaning: Mapping[str, str]) -> str:
        return "\n".join(
            f"    {initializer(value, precision)}, /* {meaning[name]} */"
            for name, value in values.items()
        )

    if not isinstance(observer, AdaptiveObserver):
        return lines(observer.parameters(), MEANING)
    inner = lines(observer.plain.parameters(), MEANING)
    return f"    {{\n{inner}\n    }},\n{lines(observer.parameters(), ADAPTIVE_MEANING)}"


def parameters(machine: RotatingMachine) -> dict[str, str]:
    """What the machine file says, with units."""
    units = {"R_s": "ohm", "n_p": "pole pairs", "psi_f": "Wb", "rated_current": "A"}
    units |= {"inverter_voltage": "V", "inverter_current": "A"}
    given = machine.model_dump(by_alias=True, exclude_none=True)
    return {"kind": machine.kind} | {
        name: f"{value:.9g} {units.get(name, 'H')}" for name, value in given.items()
    }
