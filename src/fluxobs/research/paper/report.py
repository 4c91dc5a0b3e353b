"""Report of the paper's claims and the measured results, as numbers and as Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from .counter_example import CounterExample
from .levitation import (
    ADAPTIVE_GAIN,
    CORNER,
    CURRENT_BIAS,
    DURATION,
    JUMP,
    MODULATION,
    R_A,
    ROBUST_GAIN,
    SCENARIOS,
    VOLTAGE_BIAS,
)
from .scenario import MAIN, ScenarioResult
from .section_v import (
    CONSTANTS_RATE,
    FLUX_RATE,
    FROM_THE_START,
    LS_MEMORY,
    LS_SAMPLE_TIME,
    RUN_IN,
    ErrorCourse,
    rms,
)

#: Flux errors below which an observer counts as settled.
LEVELS = (0.02, 1e-3, 1e-6)
#: Error over the largest flux above which the report shows no digits.
DIVERGED = 1e6


def course_numbers(course: ErrorCourse, jump: float) -> dict[str, Any]:
    """Return errors before and after the jump and settling times after the jump (None if never)."""
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
    """Return all numbers of the report for ``numbers.json``."""
    half = float(next(iter(motor.values())).t[-1] / 2)
    return {
        "scenarios": {
            run.scenario.name: {
                "title": run.scenario.title,
                "tracking": run.tracking,
                "reference": float(np.sqrt(np.mean(run.reference**2))),
                "courses": {
                    name: course_numbers(course, run.jump) for name, course in run.courses.items()
                },
                "largest_flux": run.largest_flux,
                "excitation": asdict(run.excited),
                "stability": None if run.growth is None else asdict(run.growth),
                "parameters": {
                    when: {name: asdict(estimate) for name, estimate in constants.items()}
                    for when, constants in run.parameters.items()
                },
                "mechanics": {"position": run.mechanics[0], "velocity": run.mechanics[1]},
                "robust": None
                if run.robust is None
                else {
                    "rms": {f"{factor:g}": rms for factor, rms in run.robust.rms.items()},
                    "bound": run.robust.bound,
                    "tight": run.robust.tight,
                    "largest": run.robust.largest,
                },
                "noise": None if run.noise is None else asdict(run.noise),
            }
            for run in runs
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
    """Return a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def error_text(value: float) -> str:
    """Format a relative error with two digits."""
    if value < 1e-9:
        return "< 1e-9"
    if not value < DIVERGED:
        return "diverges"
    return f"{value:.1e}" if value < 0.01 else f"{value:.2g}"


def _time(value: float | None) -> str:
    return "never" if value is None else f"{value:.2f} s"


def _settled(level: str, value: float | None) -> str:
    """Say from when on an error stays below a level after the jump."""
    return f"never below {level}" if value is None else f"below {level} within {_time(value)}"


def _courses(courses: Mapping[str, Any]) -> str:
    return table(
        ["observer", "rms error before the jump", "at the end"]
        + [f"stays below {level:g} from … after the jump" for level in LEVELS],
        [
            [name, error_text(course["before"]), error_text(course["end"])]
            + [_time(course["settled"][f"{level:g}"]) for level in LEVELS]
            for name, course in courses.items()
        ],
    )


def _from_the_start(courses: Mapping[str, Any]) -> str:
    """Say what the law does if it adapts from the first sample on, as the paper prints it."""
    course = courses.get(FROM_THE_START)
    if course is None:
        return ""
    return (
        f"; adapting from t = 0, without our run-in of {RUN_IN / CORNER:g} s: "
        f"{error_text(course['before'])} and {error_text(course['end'])}"
    )


def _settings() -> list[str]:
    """Return what the scenarios assume, from the code: a reader can rebuild them."""
    rows = [
        [
            scenario.name,
            f"{scenario.alpha:g}, {-scenario.alpha:g}",
            f"{scenario.G:g}",
            f"{scenario.bias_current:g} A",
            f"{scenario.depth:g} at {MODULATION:g} rad/s" if scenario.depth else "none",
            "φ*" if np.isnan(scenario.initial_flux) else f"{scenario.initial_flux:g} Wb",
            f"{scenario.period:.4g} s",
        ]
        for scenario in SCENARIOS.values()
    ]
    biases = "; ".join(
        f"{when}: current ({1e3 * i[0]:g}, {1e3 * i[1]:g}) mA, voltage ({1e3 * u[0]:g}, "
        f"{1e3 * u[1]:g}) mV"
        for when, i, u in zip(("before", "after"), CURRENT_BIAS, VOLTAGE_BIAS, strict=True)
    )
    gains = ", ".join(f"{gain:g}" for gain in ADAPTIVE_GAIN)
    return [
        "## What the scenarios assume",
        "α, β, G and R_a are those of the controller. The bias flux is φ* = k I/g, that of the "
        "bias current I in the middle of the gap. Position reference: 10⁻⁵ (6 sin 10t + "
        "4 sin 20t + 6 sin 15t) m.",
        table(
            ["scenario", "α, β", "G", "bias current", "modulation of φ*", "start", "period"], rows
        ),
        f"R_a = {R_A:g}; ν = {CORNER:g} 1/s; duration {DURATION:g} s, jump at {JUMP:g} s (in a "
        f"quick run 30 s and 15 s). Biases "
        f"{biases}. The filters start from zero. Observers use the regression from "
        f"{RUN_IN / CORNER:g} s on (15/ν): until then it contains the filters' transient, which "
        "decays as e^(-νt) and which the gains multiply; a full run also has the printed law from "
        f"t = 0, for the main scenario. Printed gains: Γ = {ROBUST_GAIN:g}, "
        f"Γ_a = diag({gains}). Balanced gain: {FLUX_RATE:g} 1/s times the inverse of the mean of "
        f"Φ_λΦ_λᵀ between run-in and jump; the repaired law has the same gain for the flux and "
        f"{CONSTANTS_RATE:g} 1/s for the constants. Least squares: samples of "
        f"{LS_SAMPLE_TIME:g} s, memory {LS_MEMORY:g} s.",
    ]


def _claims(results: Mapping[str, Any]) -> str:
    main = results["scenarios"][MAIN]
    courses, robust = main["courses"], main["robust"]
    integrator = courses["robust, printed gain"]["end"] / courses["voltage model"]["end"]
    rms = robust["rms"]
    printed, repaired = courses["adaptive, printed gain"], courses["adaptive, repaired"]
    ls = courses["least squares"]
    multipliers = results["counter_example"]["multipliers"]
    rows = [
        [
            "Figure 2: the robust observer's error is bounded",
            "with the printed gain, the observer equals the voltage model (error ratio "
            f"{integrator:.3f}); with a balanced gain, the error is bounded: "
            f"{error_text(courses['robust, balanced gain']['before'])} rms",
        ],
        [
            "the steady error depends on the size of the biases",
            "biases halved, unchanged, doubled, in the second half before the jump: "
            f"{rms['0.5']:.3f}, {rms['1']:.3f}, {rms['2']:.3f}",
        ],
        [
            "the error has an explicit bound",
            f"corrected bound {robust['bound']:.1e}; least bound for disturbances of this size "
            f"along the trajectory {robust['tight']:.2g}; largest error {robust['largest']:.2g}",
        ],
        [
            "Figure 3: errors of flux and parameters converge to zero",
            f"with the printed gains {error_text(printed['before'])} before and "
            f"{error_text(printed['end'])} after the jump; "
            f"{_settled('2 %', printed['settled']['0.02'])}{_from_the_start(courses)}",
        ],
        [
            "(these equations as printed, without ν in Φ_λ)",
            f"{error_text(courses['adaptive, printed gain and Φ']['end'])} at the end",
        ],
        [
            "the errors converge again after the biases jump",
            f"repaired: {_settled('1e-3', repaired['settled']['0.001'])}; least squares: "
            f"{_settled('2 %', ls['settled']['0.02'])}, "
            f"{_settled('1e-6', ls['settled']['1e-06'])}",
        ],
        [
            "Proposition 2: the error converges above some γ_min",
            "PMSM with persistently exciting Ψ "
            f"(α = {results['counter_example']['alpha']:.2f}): largest Floquet multiplier "
            + ", ".join(f"{value:.2f}" for value in multipliers)
            + f" for γ = 1e-3 … 1e4: stable at {sum(value < 1 for value in multipliers)} of "
            f"{len(multipliers)} gains",
        ],
    ]
    return table(["the paper", f"measured (scenario {MAIN})"], rows)


def _scenario(name: str, run: Mapping[str, Any]) -> list[str]:
    return [
        f"### {name}: {run['title']}",
        f"The position differs from its reference by {1e6 * run['tracking']:.0f} µm rms; the "
        f"reference itself is {1e6 * run['reference']:.0f} µm rms. The reference is faster than "
        "the closed loop, whose law assumes constant references. The largest flux is "
        f"{1e6 * run['largest_flux']:.3g} µWb.",
        _courses(run["courses"]),
    ]


def _excitation(scenarios: Mapping[str, Any]) -> list[str]:
    return [
        "## Excitation",
        "The table shows the per-unit ratio of smallest to largest eigenvalue over 2 s and the "
        "direction that the observability Gramian sees least. The first two columns need no "
        "filter. The covariance of the relation's gradient n = ∇_λ w is bounded below over all "
        "windows if and only if (pe1) holds. The smallest eigenvalue of the Gramian of "
        "(n, n t, −1) is positive if and only if flux and drift are observable. For the "
        "levitation n = (φ₂(g − q), φ₁(g + q)): while the common flux is constant, "
        "only the force for the acceleration moves n₁ + n₂.",
        table(
            [
                "scenario",
                "n",
                "(n, n t, −1)",
                "Φ_λ (pe1)",
                "Ψ (pe2)",
                "observability",
                "seen least",
            ],
            [
                [
                    name,
                    *(
                        f"{run['excitation'][key]:.1e}"
                        for key in (
                            "gradient",
                            "certificate",
                            "flux",
                            "all_constants",
                            "observability",
                        )
                    ),
                    ", ".join(
                        f"{unknown} {share:.2g}"
                        for unknown, share in run["excitation"]["weakest"].items()
                        if share > 0.01
                    ),
                ]
                for name, run in scenarios.items()
            ],
        ),
    ]


def _growth(value: float, error: float) -> str:
    """Format a growth rate with its significant digits; return zero if the sign is uncertain."""
    if abs(value) <= error:
        return f"0 ± {error:.2g}"
    if error < 0.005 * abs(value):
        return f"{value:+.3g}"
    digits = max(0, 1 - int(np.floor(np.log10(error))))
    return f"{value:+.{digits}f} ± {error:.{digits}f}"


def _stability(scenarios: Mapping[str, Any]) -> list[str]:
    studied = {name: run["stability"] for name, run in scenarios.items() if run["stability"]}
    if not studied:
        return []
    factors = list(next(iter(studied.values()))["before"])
    rows = [
        [
            f"{name}, {when} the jump",
            "none" if run["period"] is None else f"{run['period']:.3f} s",
            *(_growth(*run[when][factor]) for factor in factors),
            *(f"{value:+.3g}" for value in run["limits"][when]),
        ]
        for name, run in studied.items()
        for when in ("before", "after")
    ]
    return [
        "## Stability of Proposition 2",
        "The table shows the growth rate of the error [1/s] for the printed gain matrix times the "
        "factor; a positive rate is unstable. If the scenario settles to a periodic orbit, the "
        "rate is ln |largest Floquet multiplier| over the period, with all digits converged in the "
        "step. Otherwise, the rate is the largest Lyapunov exponent of the record, ± its change "
        "when record and step are halved. The last two columns are closed forms (docs/theorems.md, "
        "Theorems 3 and 4). At small gains the rate is √γ times the first number. It is positive "
        "for every relation and periodic trajectory, because the regressor of the drift lags "
        "behind that of the flux by the group delay of the filters. At large gains, the second "
        "number is the sum of all rates but the fastest. If it is positive, so is at least one of "
        "them.",
        table(
            [
                "scenario",
                "period",
                *(f"γ × {factor}" for factor in factors),
                "γ → 0: rate/√γ",
                "γ → ∞: sum of rates",
            ],
            rows,
        ),
    ]


def _pair(values: Sequence[float], scale: float) -> str:
    """Format a pair with at least two digits of the smaller value."""
    return "(" + ", ".join(_number(scale * value) for value in values) + ")"


def _number(value: float) -> str:
    return f"{value:.3f}" if value == 0 or abs(value) >= 0.01 else f"{value:.1e}"


def _parameters(scenarios: Mapping[str, Any]) -> list[str]:
    rows = []
    for name, run in scenarios.items():
        for when, constants in run["parameters"].items():
            for constant, scale in (("drift", 1e6), ("current bias", 1e3)):
                estimate = constants[constant]
                rows.append(
                    [
                        f"{name}, {when} the jump",
                        f"{constant} [{'µV' if constant == 'drift' else 'mA'}]",
                        _pair(estimate["true"], scale),
                        _pair(estimate["estimate"], scale),
                        _pair(estimate["std"], scale),
                        f"{estimate['known']:.0%}",
                    ]
                )
    return [
        "## The constants, by least squares",
        "The flux is right in every scenario; the constants are right where the trajectory makes "
        "them identifiable. *Known* is the share of samples in the last fifth of the span that "
        "the observer reports as valid: `valid` for flux and drift, `current_bias_valid` for the "
        "current bias. The std is the median over the last fifth. It assumes sensor noise, which "
        "these runs do not have.",
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
                    f"{run['mechanics']['position']:.1e} m",
                    f"{run['mechanics']['velocity']:.1e} m/s",
                ]
                for name, run in scenarios.items()
            ],
        ),
    ]


def _noise(scenarios: Mapping[str, Any]) -> list[str]:
    rows = [
        [
            name,
            f"{run['error']:.1%}",
            f"{run['claimed']:.1%}",
            f"{run['noise_share']:.2g}",
            f"{run['valid']:.0%}",
        ]
        for name, scenario in scenarios.items()
        if (run := scenario["noise"])
    ]
    if not rows:
        return []
    return [
        "## With noise",
        "The first 10 s have white noise of 1 mA and 10 mV at 1 kHz and converter steps of 0.5 mA "
        "and 5 mV; the memory is 0.5 s, and drift and current bias are unknown. With little "
        "excitation, the error stated by the covariance is far too small. The noise share, the "
        "part of the information that is only noise, shows this.",
        table(["", "rms error", "claimed by covariance", "noise share", "claimed valid"], rows),
    ]


def _convergence(scenarios: Mapping[str, Any]) -> str:
    changes = [
        course["change"]
        for run in scenarios.values()
        for course in run["courses"].values()
        if course["change"] is not None
    ]
    return (
        "The runs of the paper's two laws are converged: halving the step changes no error by "
        f"more than {max(changes):.0e} of the largest error."
    )


def markdown(results: Mapping[str, Any], more: Sequence[str] = ()) -> str:
    """Return the report; `more` contains further sections."""
    scenarios: Mapping[str, Any] = results["scenarios"]
    errors = results["counter_example"]["errors"]
    sections = [
        "# Section V of the paper, reproduced",
        "A. Pyrkin, A. Vedyakov, R. Ortega, A. Bobtsov, *A Robust Adaptive Flux Observer for a "
        "Class of Electromechanical Systems*. Two opposed coils under IDA-PBC are simulated with "
        "the consistent model and measured with the paper's biases, which jump at half time. "
        "Errors are those of the flux vector, divided by its largest length. All observers start "
        "from zero. The paper does not give G of the controller and the initial fluxes; ours are "
        "in the table below. The claims are tested on S5, not on the paper's own S1: without bias "
        "flux, the closed loop of S1 is unstable and its excitation decays. S1 is in the other "
        "sections of a full run."
        + (
            ""
            if len(scenarios) > 1
            else " This quick run has only S5, of 30 s; the jump is at 15 s."
        ),
        "## Claims",
        _claims(results),
        *_settings(),
        "These figures show the paper's law with the paper's gains, in Wb and V on linear axes:",
        "![Figure 2](figure_2.png)",
        "![Figure 3](figure_3.png)",
        "These figures compare the runs with the other observers (relative errors, logarithmic):",
        "![robust observer](robust.png)",
        "![adaptive observer, flux](adaptive_flux.png)",
        "![adaptive observer, parameters](adaptive_parameters.png)",
        "## Every observer, every scenario",
        *(text for name, run in scenarios.items() for text in _scenario(name, run)),
        "The least squares uses 100 samples per second and a memory of 0.1 s; drift and current "
        "bias are unknown. Its residual causes a restart at the jump. A balanced gain is the "
        "inverse of the regressor's mean square, computed on the record before the jump. "
        + _convergence(scenarios),
        "![trajectories](trajectories.png)",
        "![baselines](baselines.png)",
        *_excitation(scenarios),
        *_parameters(scenarios),
        *_stability(scenarios),
        *_mechanics(scenarios),
        *_noise(scenarios),
        "## PMSM",
        "The voltage and current sensors of this servo motor have offsets. Errors are those of the "
        "active flux λ - L i, divided by ψ; a current bias does not affect the active flux. Least "
        "squares is the production observer.",
        _courses(results["motor"]),
        "![PMSM](pmsm.png)",
        "## Proposition 2 is false",
        "Per-unit surface PMSM with θ_e = t + 0.8 sin t, L = 0.4, i_q = 0.5, ψ = 1, ν = 1, no "
        "bias, and the unknowns (λ, θ, 2/ν θᵀθ). Flux errors after 30 periods: "
        + "; ".join(f"{name}: {value:.1e}" for name, value in errors.items())
        + ".",
        "![counter-example](counter_example.png)",
        *more,
    ]
    return "\n\n".join(sections) + "\n"
