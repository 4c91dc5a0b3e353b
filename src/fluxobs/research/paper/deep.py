"""Long studies, run by ``fluxobs reproduce --deep``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from . import closed_loop, later_line, levitation_errata, smoothing
from .levitation import SCENARIOS, record
from .report import course_numbers, error_text, table
from .scenario import NOISY
from .smoothing import AT_REST, RIPPLE
from .stability import scalar_gain
from .studies import CURRENT_NOISE, VOLTAGE_NOISE, noisy

#: Noisy records for the smoother: duration [s], and seeds of the noise.
DURATION, SEEDS = 10.0, (1, 11, 21)


def study(say: Callable[[str], Any]) -> dict[str, Any]:
    """Return the numbers of all long studies, for ``numbers.json``."""
    scalar = scalar_gain()
    say("Proposition 2 with a scalar gain on S5")
    later, observable = {}, {}
    for case in later_line.cases():
        jump = min(case.record.jump, float(case.record.t[-1]) / 2)
        later[case.title] = {
            name: course_numbers(course, jump) for name, course in later_line.courses(case).items()
        }
        if case.title in ("S1", "S3", "S5"):
            observable[case.title] = asdict(later_line.observability(case.record))
        say(f"the later line: {case.title}")
    errata = asdict(levitation_errata.study())
    for name in ("poles", "printed_poles"):
        errata[name] = [[pole.real, pole.imag] for pole in errata[name]]
    loops = {}
    for rig in closed_loop.rigs():
        loops[rig.name] = {name: asdict(run) for name, run in closed_loop.study(rig).items()}
        say(f"closed loop: {rig.name}")
    return {
        "all_rows": all_rows(say),
        "at_rest": asdict(smoothing.at_rest()),
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


def all_rows(say: Callable[[str], Any]) -> dict[str, Any]:
    """Return the errors of least squares and smoother on noisy records of each scenario."""
    results = {}
    for name in NOISY:
        base = record(SCENARIOS[name], quick=True)
        runs = [smoothing.smoothed(base, DURATION, seed) for seed in SEEDS]
        results[name] = {
            "least_squares": noisy(base, DURATION, smoothing.MEMORY).error,
            "runs": [asdict(run) for run in runs],
        }
        say(f"{name}: every row from all rows")
    return results


def _all_rows(scenarios: Mapping[str, Any], rest: Mapping[str, float]) -> list[str]:
    def span(values: Sequence[float]) -> str:
        return f"{min(values):.1%} … {max(values):.1%}"

    rows = [
        [
            name,
            f"{result['least_squares']:.1%}",
            *(span([run[key] for run in result["runs"]]) for key in ("error", "claimed", "within")),
            f"{max(run['slope_uncertainty'] for run in result['runs']):.2g}",
            "yes" if all(run["valid"] for run in result["runs"]) else "no",
        ]
        for name, result in scenarios.items()
    ]
    return [
        "## Every row from all rows, and at rest",
        f"The first {DURATION:g} s with white noise of {1e3 * CURRENT_NOISE:g} mA and "
        f"{1e3 * VOLTAGE_NOISE:g} mV at 1 kHz, {len(SEEDS)} times. The smoother (docs/theorems.md, "
        "Theorem 8) estimates flux, drift and current offsets of every row from all rows. The last "
        "column compares the uncertainty of the relation's slope along the weak direction of the "
        "flux with this slope (mean squares). Where it is large, the covariance of the linearised "
        "problem does not describe the error, and the smoother says that it is not valid.",
        table(
            [
                "scenario",
                "least squares, rms error",
                "smoother, rms error",
                "stated",
                "components within two standard deviations",
                "uncertainty of the slope",
                "valid",
            ],
            rows,
        ),
        f"At rest, with a current ripple of {1e3 * RIPPLE:g} mA at a quarter of the sampling rate "
        f"for {AT_REST:g} s (Theorem 9), the position is known to "
        f"{1e6 * rest['position']:.2f} µm (stated: {1e6 * rest['position_std']:.2f} µm; closed "
        f"form: {1e6 * rest['bound']:.2f} µm) and the flux to {rest['flux']:.2%} (stated: "
        f"{rest['flux_std']:.2%}).",
    ]


def _scalar(results: Mapping[str, Any]) -> list[str]:
    rows = [
        [f"× {unit}" if unit != "1" else "as they are", *(f"{value:.3g}" for value in multipliers)]
        for unit, multipliers in results["multipliers"].items()
    ]
    every = [value for multipliers in results["multipliers"].values() for value in multipliers]
    limits = [multipliers[-1] for multipliers in results["multipliers"].values()]
    return [
        "## Proposition 2 is false on the paper's own example",
        "S5 has the paper's seven unknowns and a scalar gain. Each unknown has the unit in which "
        "the rms of its regressor is one. Ψ is persistently exciting: the smallest eigenvalue of "
        f"its mean square is {results['alpha']:.1e}. The table shows the largest |Floquet "
        "multiplier| over the period, also for other units of the drift, because the proposition "
        f"does not fix the units. The law is unstable at {sum(value > 1 for value in every)} of "
        f"{len(every)} gains. Above the highest gain, the multiplier no longer changes; there it "
        f"is at least {min(limits):.3f}, so no γ_min exists.",
        table(["unit of the drift", *(f"γ = {gain:.0e}" for gain in results["gains"])], rows),
    ]


def _later(courses: Mapping[str, Any], observability: Mapping[str, Any]) -> list[str]:
    titles = list(courses)
    names = list(courses[titles[0]])
    rows = [
        [
            name,
            *(
                f"{error_text(courses[title][name]['before'])}; "
                f"{error_text(courses[title][name]['end'])}"
                for title in titles
            ),
        ]
        for name in names
    ]
    observability_rows = [
        [name, f"{window['least']:.1e}", f"{window['flux_std']:.1%}"]
        for name, window in observability.items()
    ]
    return [
        "## Observers published later",
        "The table shows the rms flux error over the largest flux, before the jump (or half time) "
        "and at the end. Every observer gets 100 samples per second of the exact regression.",
        table(["observer", *titles], rows),
        "The least squares on the immersion needs uniform observability instead of persistent "
        "excitation: a lower bound of its Gramian over every window of one length. The table shows "
        "the worst second before the jump:",
        table(
            [
                "scenario",
                "smallest over largest eigenvalue, unit diagonal",
                "std of the flux for 1 mA of noise at 100 Hz",
            ],
            observability_rows,
        ),
    ]


def _errata(results: Mapping[str, Any]) -> list[str]:
    def rightmost(poles: Sequence[Sequence[float]]) -> str:
        return ", ".join(
            f"{real:.3g}" + (f" ± {abs(imag):.4g}j" if imag else "")
            for real, imag in poles
            if imag >= 0
        )

    return [
        "## The levitation as printed",
        f"The literal model under the printed controller grows at "
        f"{results['literal_growth']:.3g} 1/s. In S2, the consistent model has the poles "
        f"{rightmost(results['poles'])} 1/s with corrected z̃₂ and "
        f"{rightmost(results['printed_poles'])} 1/s with printed z̃₂. The smallest per-unit "
        f"curvature of the shaped energy is {results['stiffness']:.1e} with the bias flux of S2 "
        f"and {results['stiffness_without_flux']:.0e} with φ* = 0, where no minimum exists.",
    ]


def _time(value: float | None, otherwise: str) -> str:
    return otherwise if value is None else f"{value:.2f}"


def _error_or_dash(value: float) -> str:
    """Return an error, or a dash if the rig was not handed over or was lost before."""
    return error_text(value) if np.isfinite(value) else "–"


def _loops(results: Mapping[str, Any]) -> list[str]:
    rows = [
        [
            rig,
            observer,
            _time(run["handed_over"], "never"),
            _time(run["lost"], "no"),
            *(_error_or_dash(run[name]) for name in ("before", "after", "peak", "flux_error")),
        ]
        for rig, observers in results.items()
        for observer, run in observers.items()
    ]
    return [
        "## Closed loop",
        "IDA-PBC uses an observer's flux, position and momentum; the bias flux is modulated as in "
        "S5. IDA-PBC uses the true state until the observer is trusted. The offsets jump at time "
        "15, the run ends at 30. Times are in units of the rig (1 s for the levitation), distances "
        "are divided by the gap. With the true state, the jump does not increase the distance "
        "from the reference.",
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


def markdown(results: Mapping[str, Any]) -> list[str]:
    """Return the sections of the report on the long studies."""
    return [
        *_all_rows(results["all_rows"], results["at_rest"]),
        *_scalar(results["scalar_gain"]),
        "![Proposition 2 with a scalar gain](scalar_gain.png)",
        *_later(results["later_line"], results["observability"]),
        *_errata(results["erratum_8"]),
        *_loops(results["closed_loop"]),
    ]
