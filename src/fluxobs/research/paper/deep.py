"""Long studies: ``fluxobs reproduce --deep``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from . import closed_loop, later_line, levitation_errata
from .report import course_numbers, error_text, table
from .stability import scalar_gain


def study(say: Callable[[str], Any]) -> dict[str, Any]:
    """Numbers of all long studies, for ``numbers.json``."""
    scalar = scalar_gain()
    say("Proposition 2 with a scalar gain on S5")
    later, observable = {}, {}
    for case in later_line.cases():
        jump = min(case.given.jump, float(case.given.t[-1]) / 2)
        later[case.title] = {
            name: course_numbers(course, jump) for name, course in later_line.courses(case).items()
        }
        if case.title in ("S1", "S3", "S5"):
            observable[case.title] = asdict(later_line.observability(case.given))
        say(f"the later line: {case.title}")
    errata = asdict(levitation_errata.study())
    for name in ("poles", "printed_poles"):
        errata[name] = [[pole.real, pole.imag] for pole in errata[name]]
    loops = {}
    for rig in closed_loop.rigs():
        loops[rig.name] = {name: asdict(one) for name, one in closed_loop.study(rig).items()}
        say(f"closed loop: {rig.name}")
    return {
        "scalar_gain": {
            "alpha": scalar.alpha,
            "gains": scalar.gains.tolist(),
            "multipliers": {f"{unit:g}": m.tolist() for unit, m in scalar.multipliers.items()},
        },
        "later_line": later,
        "observability": observable,
        "erratum_8": errata,
        "closed_loop": loops,
    }


def _scalar(found: Mapping[str, Any]) -> list[str]:
    rows = [
        [f"× {unit}" if unit != "1" else "as they are", *(f"{value:.3g}" for value in multipliers)]
        for unit, multipliers in found["multipliers"].items()
    ]
    every = [value for multipliers in found["multipliers"].values() for value in multipliers]
    limits = [multipliers[-1] for multipliers in found["multipliers"].values()]
    return [
        "## Proposition 2 is false on the paper's own example",
        "S5 with the paper's seven unknowns and a scalar gain, each unknown in the unit that makes "
        "the rms of its regressor one; Ψ is persistently exciting, smallest eigenvalue of its mean "
        f"square {found['alpha']:.1e}. Largest |Floquet multiplier| over the period, and the same "
        f"with another unit for the drift, which the proposition leaves open. Unstable at "
        f"{sum(value > 1 for value in every)} of {len(every)} gains; at the highest gain, from "
        f"which the multiplier no longer changes, at least {min(limits):.3f}: no γ_min exists.",
        table(["unit of the drift", *(f"γ = {gain:.0e}" for gain in found["gains"])], rows),
    ]


def _later(found: Mapping[str, Any], observable: Mapping[str, Any]) -> list[str]:
    titles = list(found)
    names = list(found[titles[0]])
    rows = [
        [
            name,
            *(
                f"{error_text(found[title][name]['before'])}; "
                f"{error_text(found[title][name]['end'])}"
                for title in titles
            ),
        ]
        for name in names
    ]
    seen = [
        [name, f"{one['least']:.1e}", f"{one['flux_std']:.1%}"] for name, one in observable.items()
    ]
    return [
        "## The line that followed",
        "Flux error over its largest size, rms before the jump (or half way) and at the end; every "
        "observer at 100 samples a second on the exact regression.",
        table(["observer", *titles], rows),
        "What replaces persistent excitation for the least squares on the immersion is uniform "
        "observability: a lower bound for its Gramian over every window of one length. In the "
        "worst second before the jump:",
        table(
            [
                "scenario",
                "smallest over largest eigenvalue, unit diagonal",
                "std of the flux for 1 mA of noise at 100 Hz",
            ],
            seen,
        ),
    ]


def _errata(found: Mapping[str, Any]) -> list[str]:
    def rightmost(poles: Sequence[Sequence[float]]) -> str:
        return ", ".join(
            f"{real:.3g}" + (f" ± {abs(imag):.4g}j" if imag else "")
            for real, imag in poles
            if imag >= 0
        )

    return [
        "## The levitation as printed",
        f"The model to the letter, under the printed controller: grows at "
        f"{found['literal_growth']:.3g} 1/s. Poles of the consistent model in S2 with z̃₂ "
        f"corrected: {rightmost(found['poles'])} 1/s; as printed: "
        f"{rightmost(found['printed_poles'])} 1/s. Least curvature of the shaped energy, per-unit: "
        f"{found['stiffness']:.1e} with the bias flux of S2, "
        f"{found['stiffness_without_flux']:.0e} with φ* = 0: no minimum.",
    ]


def _time(value: float | None, otherwise: str) -> str:
    return otherwise if value is None else f"{value:.2f}"


def _if_any(value: float) -> str:
    """An error, or a dash where there was none: not handed over, or lost before."""
    return error_text(value) if np.isfinite(value) else "–"


def _loops(found: Mapping[str, Any]) -> list[str]:
    rows = [
        [
            rig,
            observer,
            _time(one["handed_over"], "never"),
            _time(one["lost"], "no"),
            *(_if_any(one[name]) for name in ("before", "after", "peak", "flux_error")),
        ]
        for rig, observers in found.items()
        for observer, one in observers.items()
    ]
    return [
        "## The loop closed",
        "IDA-PBC from an observer's flux, position and momentum; bias flux modulated as in S5; the "
        "true state until the observer is trusted. The offsets jump at 15, the run ends at 30. "
        "Times in units of the rig: 1 s for the levitation. Distances over the gap; without an "
        "observer the law follows its reference as well as before the jump.",
        table(
            [
                "rig",
                "observer",
                "handed over",
                "lost",
                "distance, before",
                "at the end",
                "largest after the jump",
                "flux error",
            ],
            rows,
        ),
    ]


def markdown(found: Mapping[str, Any]) -> list[str]:
    """Sections of the report."""
    return [
        *_scalar(found["scalar_gain"]),
        "![Proposition 2 with a scalar gain](scalar_gain.png)",
        *_later(found["later_line"], found["observability"]),
        *_errata(found["erratum_8"]),
        *_loops(found["closed_loop"]),
    ]
