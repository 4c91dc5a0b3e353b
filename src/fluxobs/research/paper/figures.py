"""Figures of the reproduction."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...core.plots import BLUE, GREY, ORANGE, STYLE, write
from .counter_example import CounterExample
from .scenario import ScenarioResult
from .section_v import ErrorCourse

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

GREEN, RED, VIOLET = "#3a8f4d", "#b4332e", "#7b5aa6"
#: Points drawn per curve.
POINTS = 1000
FLOOR = 1e-13
_FLUX = "|λ̂ - λ| over largest |λ|"

COLOURS = {
    "robust, printed gain": GREY,
    "robust, balanced gain, printed Φ": RED,
    "robust, balanced gain": ORANGE,
    "adaptive, printed gain": ORANGE,
    "adaptive, printed gain and Φ": RED,
    "adaptive, ten times the gain": GREY,
    "adaptive, printed law": RED,
    "adaptive, repaired": GREEN,
    "voltage model": GREY,
    "PEBO, least squares": VIOLET,
    "Riccati, memory 1 s": RED,
    "DREM, finite time": ORANGE,
    "least squares": BLUE,
}
#: Wide lines are drawn first, for curves below other curves. Curves on top are dashed.
WIDE = {"linewidth": 3.5, "alpha": 0.5, "zorder": 1}
DASHED = {"linestyle": "--", "zorder": 3}
LINES: dict[str, dict[str, Any]] = {
    "robust, printed gain": WIDE,
    "robust, balanced gain, printed Φ": DASHED,
    "adaptive, ten times the gain": WIDE,
    "voltage model": WIDE,
    "PEBO, least squares": DASHED,
    "Riccati, memory 1 s": WIDE,
    "DREM, finite time": DASHED,
}


def _new(columns: int, rows: int = 1) -> tuple[Figure, Any]:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        rows,
        columns,
        figsize=(5.2 * columns if columns > 1 else 8, 3.4 * rows + 0.4),
        layout="constrained",
        squeeze=False,
    )
    return figure, axes


def _courses(
    axes: Axes,
    courses: dict[str, ErrorCourse],
    names: Sequence[str],
    jump: float,
    constants: bool = False,
) -> None:
    for name in names:
        if name not in courses:
            continue
        course = courses[name]
        values = course.constants if constants else course.flux
        if values is None:
            continue
        step = max(1, len(course.t) // POINTS)
        with np.errstate(invalid="ignore"):
            shown = np.maximum(values[::step], FLOOR)
        axes.semilogy(
            course.t[::step], shown, color=COLOURS[name], label=name, **LINES.get(name, {})
        )
    axes.axvline(jump, color=GREY, linewidth=0.6, linestyle=":")
    axes.set_xlim(0, courses["voltage model"].t[-1])
    axes.set_xlabel("t [s]    dotted line: jump of the biases")


def _legend(axes: Axes) -> None:
    axes.figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)


def _pair(
    runs: Sequence[ScenarioResult],
    title: str,
    names: Sequence[str],
    ylabel: str,
    constants: bool = False,
) -> Figure:
    figure, axes = _new(len(runs))
    figure.suptitle(title, fontsize=10)
    for panel, run in zip(axes[0], runs, strict=True):
        _courses(panel, run.courses, names, run.jump, constants)
        panel.set_title(f"{run.scenario.name}: {run.scenario.title}")
        panel.set_ylim((1e-10, 1e6) if constants else (FLOOR, 1e3))
    axes[0, 0].set_ylabel(ylabel)
    _legend(axes[0, 0])
    return figure


def _scalar_gain(results: Mapping[str, Any]) -> Figure:
    figure, axes = _new(1)
    panel = axes[0, 0]
    colours = (RED, ORANGE, VIOLET, GREY)
    for (unit, values), colour in zip(results["multipliers"].items(), colours, strict=True):
        label = "rms of every regressor one" if unit == "1" else f"unit of the drift × {unit}"
        panel.loglog(results["gains"], values, "o-", color=colour, label=label)
    panel.axhline(1.0, color=GREY, linewidth=0.8)
    panel.set_title("S5, the paper's seven unknowns, scalar gain")
    panel.set_xlabel("γ_a")
    panel.set_ylabel("largest |Floquet multiplier|")
    panel.legend()
    return figure


ROBUST = (
    "robust, printed gain",
    "robust, balanced gain, printed Φ",
    "robust, balanced gain",
    "least squares",
)
ADAPTIVE = (
    "adaptive, printed gain and Φ",
    "adaptive, printed gain",
    "adaptive, ten times the gain",
    "adaptive, repaired",
    "least squares",
)


def _as_printed(axes: Axes, course: ErrorCourse, values: Any, jump: float) -> None:
    """Draw one curve as in the paper, on a linear axis that starts at zero."""
    axes.plot(course.t, values, color=BLUE)
    axes.axvline(jump, color=GREY, linewidth=0.6, linestyle=":")
    axes.set_xlim(0, course.t[-1])
    axes.set_ylim(bottom=0)
    axes.ticklabel_format(axis="y", style="sci", scilimits=(-2, 2))
    axes.set_xlabel("t, sec")


def _columns(runs: Sequence[ScenarioResult], printed: str, other: str) -> list[Any]:
    """Return the columns to draw: the law `printed` on every scenario, `other` on the last."""
    return [(run, printed) for run in runs] + [(runs[-1], other)]


def _figure_2(runs: Sequence[ScenarioResult]) -> Figure:
    columns = _columns(runs, "robust, printed gain", "robust, balanced gain")
    figure, axes = _new(len(columns))
    figure.suptitle(
        "Like the paper's Figure 2: norm of the robust flux observer's error", fontsize=10
    )
    for panel, (run, name) in zip(axes[0], columns, strict=True):
        course = run.courses[name]
        _as_printed(panel, course, run.largest_flux * course.flux, run.jump)
        panel.set_title(f"{run.scenario.name}: {name}")
    axes[0, 0].set_ylabel("|λ̃|, Wb")
    return figure


def _figure_3(runs: Sequence[ScenarioResult]) -> Figure:
    columns = _columns(runs, "adaptive, printed gain", "adaptive, repaired")
    figure, axes = _new(len(columns), 2)
    figure.suptitle("Like the paper's Figure 3: adaptive flux observer", fontsize=10)
    for column, (run, name) in enumerate(columns):
        course = run.courses[name]
        _as_printed(axes[0, column], course, run.largest_flux * course.flux, run.jump)
        _as_printed(axes[1, column], course, course.parameters, run.jump)
        axes[0, column].set_title(f"{run.scenario.name}: {name}")
    axes[0, 0].set_ylabel("(a) |λ̃|, Wb")
    # The paper's (b) is the norm of all parameters in mixed units; the drift dominates it.
    axes[1, 0].set_ylabel("(b) error of the drift, V")
    return figure


def _baselines(run: ScenarioResult) -> Figure:
    figure, axes = _new(1)
    names = [
        "voltage model",
        "PEBO, least squares",
        "Riccati, memory 1 s",
        "DREM, finite time",
        "least squares",
    ]
    _courses(axes[0, 0], run.courses, names, run.jump)
    axes[0, 0].set_ylim(FLOOR, 1e3)
    axes[0, 0].set_title(
        f"{run.scenario.name}: observers that the paper argues against, and others"
    )
    axes[0, 0].set_ylabel(_FLUX)
    _legend(axes[0, 0])
    return figure


def _trajectories(runs: Sequence[ScenarioResult]) -> Figure:
    figure, axes = _new(len(runs), 2)
    for column, run in enumerate(runs):
        above, below = axes[0, column], axes[1, column]
        above.plot(run.t, 1e6 * run.position, color=BLUE, label="q")
        above.plot(run.t, 1e6 * run.reference, color=ORANGE, label="q_d")
        above.set_title(f"{run.scenario.name}: {run.scenario.title}")
        below.plot(run.t, 1e6 * run.flux[:, 0], color=BLUE, label="φ_1", **WIDE)
        below.plot(run.t, 1e6 * run.flux[:, 1], color=ORANGE, label="φ_2", **DASHED)
        below.set_xlabel("t [s]")
        below.set_ylim(bottom=0)
        for panel in (above, below):
            panel.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2)
    axes[0, 0].set_ylabel("position [µm]")
    axes[1, 0].set_ylabel("core flux [µWb]")
    return figure


def _motor(courses: dict[str, ErrorCourse]) -> Figure:
    figure, axes = _new(1)
    t = courses["voltage model"].t
    _courses(axes[0, 0], courses, list(courses), float(t[-1] / 2))
    axes[0, 0].set_ylim(FLOOR, 1e3)
    axes[0, 0].set_title("PMSM, offsets of voltage and current sensors")
    axes[0, 0].set_ylabel("error of λ - L i over ψ")
    _legend(axes[0, 0])
    return figure


def _counter(counter: CounterExample) -> Figure:
    figure, axes = _new(2)
    left, right = axes[0]
    left.loglog(counter.gains, counter.multipliers, "o-", color=RED)
    left.axhline(1.0, color=GREY, linewidth=0.8)
    left.set_title("Proposition 2 as printed: unstable at every gain")
    left.set_xlabel("γ_a")
    left.set_ylabel("largest |Floquet multiplier|")
    left.set_ylim(0.5, 20)
    for name, errors in counter.errors.items():
        colour = {"printed, γ_a = 1": RED, "repaired, Γ = G = 1": GREEN}.get(name, ORANGE)
        right.semilogy(np.arange(len(errors)), np.maximum(errors, FLOOR), color=colour, label=name)
    right.set_title("errors on this trajectory, from zero")
    right.set_ylim(1e-9, 1e6)
    right.set_xlabel("periods")
    right.set_ylabel("|λ̂ - λ|")
    right.legend()
    return figure


_SCENARIOS: dict[str, Callable[[Sequence[ScenarioResult]], Figure]] = {
    "figure_2": _figure_2,
    "figure_3": _figure_3,
    "robust": partial(_pair, title="Proposition 1", names=ROBUST, ylabel=_FLUX),
    "adaptive_flux": partial(
        _pair, title="Proposition 2 and its repair: flux", names=ADAPTIVE, ylabel=_FLUX
    ),
    "adaptive_parameters": partial(
        _pair,
        title="Proposition 2 and its repair: constants",
        names=ADAPTIVE,
        ylabel="errors of θ and δ_i over their sizes",
        constants=True,
    ),
    "baselines": lambda runs: _baselines(runs[-1]),
    "trajectories": _trajectories,
}
#: Names of the levitation figures.
SCENARIO_FIGURES = tuple(_SCENARIOS)


def draw_scenarios(
    out: Path, runs: Sequence[ScenarioResult], formats: Sequence[str], names: Sequence[str]
) -> None:
    """Draw the named levitation figures, one panel per scenario; baselines only for the last."""
    _write(out, {name: partial(_SCENARIOS[name], runs) for name in names}, formats)


def draw_motors(
    out: Path, motor: dict[str, ErrorCourse], counter: CounterExample, formats: Sequence[str]
) -> None:
    """Draw the figures of the PMSM cases."""
    figures = {"pmsm": lambda: _motor(motor), "counter_example": lambda: _counter(counter)}
    _write(out, figures, formats)


def draw_scalar_gain(out: Path, results: Mapping[str, Any], formats: Sequence[str]) -> None:
    """Draw the multipliers of Proposition 2 with a scalar gain on S5."""
    _write(out, {"scalar_gain": lambda: _scalar_gain(results)}, formats)


def _write(out: Path, figures: dict[str, Callable[[], Figure]], formats: Sequence[str]) -> None:
    """Write every figure in every format."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    with plt.rc_context(STYLE):
        for name, make in figures.items():
            figure = make()
            for ending in formats:
                write(figure, out / f"{name}{ending}")
                figure.set_layout_engine("none")  # the other formats keep the layout of the first
            plt.close(figure)
