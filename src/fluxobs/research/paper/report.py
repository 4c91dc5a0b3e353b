"""The paper's claims and the measured results, as numbers and as Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from .counter_example import CounterExample
from .levitation import G_OF_PAPER, INITIAL_FLUX
from .scenario import MAIN, ScenarioResult
from .section_v import ErrorCourse, rms

#: Flux errors that count as settled.
LEVELS = (0.02, 1e-3, 1e-6)
#: Above this many times the largest flux an error has no size worth a digit.
DIVERGED = 1e6


def course_numbers(course: ErrorCourse, jump: float) -> dict[str, Any]:
    """Errors before and after the jump, and the times to settle after it (None: never)."""
    end = float(course.t[-1])
    settle = {f"{level:g}": course.first_below(level, jump) for level in LEVELS}
    spans = {"before": (0.8 * jump, 0.998 * jump), "end": (jump + 0.8 * (end - jump), end)}
    constants = {
        name: None if course.constants is None else rms(course.t, course.constants, *span)
        for name, span in spans.items()
    }
    return {
        **{name: rms(course.t, course.flux, *span) for name, span in spans.items()},
        "constants": constants,
        "change": course.change,
        "settled": {key: value if np.isfinite(value) else None for key, value in settle.items()},
    }


def numbers(
    runs: Sequence[ScenarioResult], motor: Mapping[str, ErrorCourse], counter: CounterExample
) -> dict[str, Any]:
    """All numbers of the report, for ``numbers.json``."""
    half = float(next(iter(motor.values())).t[-1] / 2)
    return {
        "scenarios": {
            one.scenario.name: {
                "title": one.scenario.title,
                "tracking": one.tracking,
                "reference": float(np.sqrt(np.mean(one.reference**2))),
                "courses": {
                    name: course_numbers(course, one.jump) for name, course in one.courses.items()
                },
                "largest_flux": one.largest_flux,
                "excitation": asdict(one.excited),
                "stability": None if one.growth is None else asdict(one.growth),
                "parameters": {
                    when: {name: asdict(found) for name, found in constants.items()}
                    for when, constants in one.parameters.items()
                },
                "mechanics": {"position": one.mechanics[0], "velocity": one.mechanics[1]},
                "robust": None
                if one.robust is None
                else {
                    "rms": {f"{factor:g}": rms for factor, rms in one.robust.rms.items()},
                    "bound": one.robust.bound,
                    "largest": one.robust.largest,
                },
                "noise": None if one.noise is None else asdict(one.noise),
            }
            for one in runs
        },
        "motor": {name: course_numbers(course, half) for name, course in motor.items()},
        "counter_example": {
            "alpha": counter.alpha,
            "gains": counter.gains.tolist(),
            "multipliers": counter.multipliers.tolist(),
            "errors": {name: float(errors[-1]) for name, errors in counter.errors.items()},
        },
    }


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def error_text(value: float) -> str:
    """A relative error with two digits."""
    if value < 1e-9:
        return "< 1e-9"
    if not value < DIVERGED:
        return "diverges"
    return f"{value:.1e}" if value < 0.01 else f"{value:.2g}"


def _time(value: float | None) -> str:
    return "never" if value is None else f"{value:.2f} s"


def _courses(found: Mapping[str, Any]) -> str:
    return table(
        ["observer", "rms error before the jump", "at the end"]
        + [f"stays below {level:g} from … after the jump" for level in LEVELS],
        [
            [name, error_text(one["before"]), error_text(one["end"])]
            + [_time(one["settled"][f"{level:g}"]) for level in LEVELS]
            for name, one in found.items()
        ],
    )


def _claims(found: Mapping[str, Any]) -> str:
    main = found["scenarios"][MAIN]
    one, robust = main["courses"], main["robust"]
    integrator = one["robust, printed gain"]["end"] / one["voltage model"]["end"]
    rms = robust["rms"]
    printed, repaired = one["adaptive, printed gain"], one["adaptive, repaired"]
    ls = one["least squares"]
    multipliers = found["counter_example"]["multipliers"]
    rows = [
        [
            "Figure 2: the robust observer's error is bounded",
            f"with the printed gain it equals the voltage model (error ratio {integrator:.3f}); "
            "with a balanced gain bounded, "
            f"{error_text(one['robust, balanced gain']['before'])} rms",
        ],
        [
            "its steady error depends on the size of the biases",
            f"biases halved, as given, doubled: {rms['0.5']:.3f}, {rms['1']:.3f}, {rms['2']:.3f}",
        ],
        [
            "with an explicit bound",
            f"corrected bound {robust['bound']:.1e}, largest error {robust['largest']:.2g}",
        ],
        [
            "Figure 3: errors of flux and parameters converge to zero",
            f"with the printed gains {error_text(printed['before'])} before and "
            f"{error_text(printed['end'])} after the jump; below 2 % within "
            f"{_time(printed['settled']['0.02'])}",
        ],
        [
            "(the same equations as printed, ν missing in Φ_λ)",
            f"{error_text(one['adaptive, printed gain and Φ']['end'])} at the end",
        ],
        [
            "and converge again after the biases jump",
            f"repaired: below 1e-3 within {_time(repaired['settled']['0.001'])}; least squares: "
            f"below 2 % within {_time(ls['settled']['0.02'])}, below 1e-6 within "
            f"{_time(ls['settled']['1e-06'])}",
        ],
        [
            "Proposition 2: there is a γ_min above which it converges",
            "PMSM, Ψ persistently exciting "
            f"(α = {found['counter_example']['alpha']:.2f}): largest Floquet multiplier "
            + ", ".join(f"{value:.2f}" for value in multipliers)
            + f" for γ = 1e-3 … 1e4: stable at {sum(value < 1 for value in multipliers)} of "
            f"{len(multipliers)} gains",
        ],
    ]
    return table(["the paper", f"measured (scenario {MAIN})"], rows)


def _scenario(name: str, one: Mapping[str, Any]) -> list[str]:
    return [
        f"### {name}: {one['title']}",
        f"The position follows its reference to {1e6 * one['tracking']:.0f} µm rms; the reference "
        f"itself is {1e6 * one['reference']:.0f} µm rms. It is faster than the closed loop, whose "
        "law assumes constant references. The largest flux is "
        f"{1e6 * one['largest_flux']:.3g} µWb.",
        _courses(one["courses"]),
    ]


def _excitation(scenarios: Mapping[str, Any]) -> list[str]:
    return [
        "## Excitation",
        "Ratio of smallest to largest eigenvalue over 2 s, per-unit, and the direction that the "
        "observability Gramian sees least.",
        table(
            ["scenario", "Φ_λ (pe1)", "Ψ (pe2)", "observability", "seen least"],
            [
                [
                    name,
                    *(
                        f"{one['excitation'][key]:.1e}"
                        for key in ("flux", "all_constants", "observability")
                    ),
                    ", ".join(
                        f"{part} {share:.2g}"
                        for part, share in one["excitation"]["weakest"].items()
                        if share > 0.01
                    ),
                ]
                for name, one in scenarios.items()
            ],
        ),
    ]


def _growth(value: float, error: float) -> str:
    """A growth rate with as many digits as are known; without a sign if that is not known."""
    if abs(value) <= error:
        return f"0 ± {error:.2g}"
    if error < 0.005 * abs(value):
        return f"{value:+.3g}"
    digits = max(0, 1 - int(np.floor(np.log10(error))))
    return f"{value:+.{digits}f} ± {error:.{digits}f}"


def _stability(scenarios: Mapping[str, Any]) -> list[str]:
    studied = {name: one["stability"] for name, one in scenarios.items() if one["stability"]}
    if not studied:
        return []
    factors = list(next(iter(studied.values()))["before"])
    rows = [
        [
            f"{name}, {when} the jump",
            "none" if one["period"] is None else f"{one['period']:.3f} s",
            *(_growth(*one[when][factor]) for factor in factors),
        ]
        for name, one in studied.items()
        for when in ("before", "after")
    ]
    return [
        "## Stability of Proposition 2",
        "Growth rate of its error [1/s], printed gain matrix times the factor; positive is "
        "unstable. Where the scenario settles to a periodic orbit, ln |largest Floquet multiplier| "
        "over the period, converged in the step to all digits shown. Without one, the largest "
        "Lyapunov exponent of the record, ± its change when record and step are halved.",
        table(["scenario", "period", *(f"γ × {factor}" for factor in factors)], rows),
    ]


def _pair(values: Sequence[float], scale: float) -> str:
    return f"({scale * values[0]:.3f}, {scale * values[1]:.3f})"


def _parameters(scenarios: Mapping[str, Any]) -> list[str]:
    rows = []
    for name, one in scenarios.items():
        for when, constants in one["parameters"].items():
            for constant, scale in (("drift", 1e6), ("current bias", 1e3)):
                found = constants[constant]
                rows.append(
                    [
                        f"{name}, {when} the jump",
                        f"{constant} [{'µV' if constant == 'drift' else 'mA'}]",
                        _pair(found["true"], scale),
                        _pair(found["estimate"], scale),
                        _pair(found["std"], scale),
                        f"{found['known']:.0%}",
                    ]
                )
    return [
        "## The constants, by least squares",
        "The flux is right in every scenario; the constants are where the trajectory shows them. "
        "*Known* is the share of samples in which the observer itself says so, over the last fifth "
        "of the span: `valid` for flux and drift, `current_bias_valid` for the current bias. The "
        "std is the median there.",
        table(["scenario", "constant", "true", "estimate", "std", "known"], rows),
    ]


def _mechanics(scenarios: Mapping[str, Any]) -> list[str]:
    return [
        "## Position and velocity from the flux",
        table(
            ["scenario", "position, rms error", "velocity, rms error"],
            [
                [
                    name,
                    f"{one['mechanics']['position']:.1e} m",
                    f"{one['mechanics']['velocity']:.1e} m/s",
                ]
                for name, one in scenarios.items()
            ],
        ),
    ]


def _noise(scenarios: Mapping[str, Any]) -> list[str]:
    rows = [
        [
            name,
            f"{one['error']:.1%}",
            f"{one['claimed']:.1%}",
            f"{one['noise_share']:.2g}",
            f"{one['valid']:.0%}",
        ]
        for name, scenario in scenarios.items()
        if (one := scenario["noise"])
    ]
    if not rows:
        return []
    return [
        "## With noise",
        "1 mA and 10 mV of white noise at 1 kHz, converter steps of 0.5 mA and 5 mV, first "
        "10 s, memory 0.5 s, drift and current bias unknown. With little excitation the covariance "
        "alone claims far too much; the noise share, the part of the information that is only "
        "noise, shows it.",
        table(["", "rms error", "claimed by covariance", "noise share", "claimed valid"], rows),
    ]


def _convergence(scenarios: Mapping[str, Any]) -> str:
    changes = [
        course["change"]
        for one in scenarios.values()
        for course in one["courses"].values()
        if course["change"] is not None
    ]
    return (
        "The runs of the paper's two laws are converged: halving the step moves no error by more "
        f"than {max(changes):.0e} of the largest."
    )


def markdown(found: Mapping[str, Any], more: Sequence[str] = ()) -> str:
    """The report; `more` are further sections."""
    scenarios: Mapping[str, Any] = found["scenarios"]
    errors = found["counter_example"]["errors"]
    parts = [
        "# Section V of the paper, reproduced",
        "A. Pyrkin, A. Vedyakov, R. Ortega, A. Bobtsov, *A Robust Adaptive Flux Observer for a "
        "Class of Electromechanical Systems*. Two opposed coils under IDA-PBC on the consistent "
        "model, measured with the paper's biases, which jump half way. Errors are those of the "
        "flux vector over its largest length; all observers start from zero. The paper gives "
        f"neither G of the controller nor the initial fluxes: {G_OF_PAPER:g} and "
        f"{INITIAL_FLUX:g} Wb are our choice."
        + ("" if len(scenarios) > 1 else " Quick run: one scenario, 30 s, jump at 15 s."),
        "## Claims",
        _claims(found),
        "As the paper draws them, its own law with its own gains, in Wb and V on linear axes:",
        "![Figure 2](figure_2.png)",
        "![Figure 3](figure_3.png)",
        "The same runs and the observers beside them, relative and logarithmic:",
        "![robust observer](robust.png)",
        "![adaptive observer, flux](adaptive_flux.png)",
        "![adaptive observer, parameters](adaptive_parameters.png)",
        "## Every observer, every scenario",
        *(part for name, one in scenarios.items() for part in _scenario(name, one)),
        "Least squares: 100 samples per second, memory 0.1 s, unknowns drift and current bias; its "
        "residual restarts it at the jump. A balanced gain is the inverse of the regressor's mean "
        "square, taken from the record before the jump. " + _convergence(scenarios),
        "![trajectories](trajectories.png)",
        "![baselines](baselines.png)",
        *_excitation(scenarios),
        *_parameters(scenarios),
        *_stability(scenarios),
        *_mechanics(scenarios),
        *_noise(scenarios),
        "## PMSM",
        "A servo motor with offsets of both sensors. Errors are those of the active flux λ - L i "
        "over ψ, which a current bias does not affect. Least squares is the production observer.",
        _courses(found["motor"]),
        "![PMSM](pmsm.png)",
        "## Proposition 2 is false",
        "Surface PMSM, θ_e = t + 0.8 sin t, L = 0.4, i_q = 0.5, ψ = 1, ν = 1, per-unit, no bias, "
        "unknowns (λ, θ, 2/ν θᵀθ). Flux errors after 30 periods: "
        + "; ".join(f"{name}: {value:.1e}" for name, value in errors.items())
        + ".",
        "![counter-example](counter_example.png)",
        *more,
    ]
    return "\n\n".join(parts) + "\n"
