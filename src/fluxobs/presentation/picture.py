"""The picture of a run: flux locus, position with its ±2σ band, speed, drift, parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.arrays import Array
from ..core.plots import BLUE, GREY, ORANGE, STYLE, legend, new_figure, plain
from ..core.validation import nearest
from ..errors import UsageError
from ..estimation.run import LogRun
from ..estimation.truth import TruthFit
from ..logs.quality.marks import MARKS
from ..logs.record import signed
from ..observers import ImmersionObserver
from .plot_data import BUDGET_LAYERS
from .summary import RPM

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


#: Figures up to this width have short titles [inch].
PRINTED = 8.0
#: A picture marks at most about this many gaps.
GAPS_SHOWN = 200
RED = "#c0392b"
GREY_LABEL = "        grey: position not valid"
#: Title and unit of each parameter that the adaptive observer estimates.
PARAMETERS = {
    "resistance": ("Resistance", "Ω"),
    "inverter_voltage": ("Inverter", "V"),
    "psi_f": ("Magnet flux", "Wb"),
}


#: Height of a strip of marks, as a share of its panel; its shortest length, as a share of the run.
STRIP, STRIP_SHARE = 0.05, 0.002
#: Colours of the layers of the budget, and of the strips of marks.
LAYERS = (BLUE, ORANGE, "#3a9d6e", "#8e6bbf", "#c9a227", "0.75")
#: Panels of every run; a run of the adaptive observer adds the panels of PARAMETERS.
PANELS = ("locus", "position", "error", "speed", "drift")


@dataclass(frozen=True)
class Paper:
    """Format of a picture: width and height of a row [inch], panels per row, style changes."""

    width: float
    height: float
    per_row: int
    changes: Mapping[str, Any] = field(default_factory=dict)


_PRINT = {"font.size": 7, "axes.titlesize": 7, "lines.linewidth": 0.7}
_PRINT |= {"axes.linewidth": 0.5, "xtick.major.width": 0.5, "ytick.major.width": 0.5}
#: The widths fit a two-column journal: 3.5 inches for a column, 7.16 inches for the page.
STYLES = {
    "screen": Paper(11.0, 2.0, 1),
    "one column": Paper(3.5, 1.35, 1, _PRINT),
    "two columns": Paper(7.16, 1.6, 2, _PRINT),
}


def figure(
    result: LogRun,
    fit: TruthFit | None = None,
    style: str = "screen",
    panels: Sequence[str] | None = None,
) -> Figure:
    """Draw the picture of a run; the immersed observer has its own panels.

    The position error refers to the truth as corrected by `fit`. For `style` and `panels`, see
    :meth:`Result.plot`.
    """
    import matplotlib as mpl

    if style not in STYLES:
        raise UsageError(f"style: {style!r}{nearest(style, STYLES)}")
    with mpl.rc_context(STYLE | STYLES[style].changes):
        if isinstance(result.observer, ImmersionObserver):
            if panels is not None or style != "screen":
                raise UsageError(
                    "style and panels: not available for the observer of a current bias"
                )
            return _immersed(result)
        return _compiled(result, fit, style, panels)


def _title(result: LogRun) -> str:
    statistics = result.statistics
    share = statistics.valid / statistics.rows
    return (
        f"{plain(result.log.path.name)}  ·  {result.machine.kind}  ·  position valid on "
        f"{share:.1%} of {statistics.rows} rows"
    )


def _compiled(
    result: LogRun, fit: TruthFit | None, style: str, panels: Sequence[str] | None
) -> Figure:
    learnt = _learnt(result)
    budget = () if result.budget is None else ("budget",)
    available = (*PANELS, *budget, *learnt)
    if panels is not None or style != "screen":
        return _chosen(result, fit, STYLES[style], PANELS if panels is None else panels, available)
    figure = new_figure(figsize=(11, 8.5 + 2 * bool(learnt) + 2 * len(budget)))
    layout = _layout(learnt, budget)
    axes = figure.subplot_mosaic(layout, height_ratios=[1.2, *[1.0] * (len(layout) - 1)])
    _draw(axes, result, fit)
    axes["error"].set_xlabel("t [s]")
    axes["speed"].sharex(axes["drift"])
    axes["speed"].tick_params(labelbottom=False)
    last = budget[-1] if budget else "drift"
    axes[last].set_xlabel("" if learnt else f"t [s]{GREY_LABEL}")
    for name in budget:
        axes[name].sharex(axes["speed"])
    for name in learnt:
        axes[name].set_xlabel(f"t [s]{GREY_LABEL if name == next(iter(learnt)) else ''}")
    figure.suptitle(f"{_title(result)}{_numbers(result, fit)}", fontsize=10)
    return figure


def _draw(axes: Mapping[str, Axes], result: LogRun, fit: TruthFit | None) -> None:
    """Draw the panels that `axes` has."""
    learnt, columns = _learnt(result), result.statistics.thin.columns()
    detail, scored = result.statistics.detail.columns(), _scored(columns, fit)
    for name, panel in axes.items():
        match name:
            case "locus":
                _locus(panel, columns)
                continue
            case "position":
                _position(panel, _scored(detail, fit))
                continue
            case "error":
                _error(panel, scored, fit)
                _gaps(panel, result)
                _marks(panel, result)
            case "speed":
                _speed(panel, scored, result.rotor.n_p)
            case "drift":
                _drift(panel, scored)
            case "budget":
                _budget(panel, result)
            case _:
                _parameter(panel, name, scored, learnt[name])
        _shade_invalid(panel, scored)
        panel.set_xlim(scored["t"][0], scored["t"][-1])


def _chosen(
    result: LogRun,
    fit: TruthFit | None,
    paper: Paper,
    panels: Sequence[str],
    available: Sequence[str],
) -> Figure:
    """Draw the chosen panels in rows, without a title."""
    for name in panels:
        if name not in available:
            raise UsageError(f"panels: {name!r}{nearest(name, available)}")
    if not panels or len(set(panels)) < len(panels):
        raise UsageError(f"panels: choose one or more, each at most once: {', '.join(available)}")
    mosaic: Any = [
        list(panels[n : n + paper.per_row]) for n in range(0, len(panels), paper.per_row)
    ]
    mosaic[-1] += [mosaic[-1][-1]] * (paper.per_row - len(mosaic[-1]))
    heights = [paper.height * (1.6 if "locus" in row else 1.0) for row in mosaic]
    figure = new_figure(figsize=(paper.width, sum(heights)))
    axes = figure.subplot_mosaic(mosaic, height_ratios=heights)
    _draw(axes, result, fit)
    for panel in axes.values():
        if not panel.get_xlabel():
            panel.set_xlabel("t [s]")
    return figure


def _learnt(result: LogRun) -> dict[str, float]:
    """Return the assumed value of each parameter of the adaptive observer, by column name."""
    adaptive = result.adaptive
    if adaptive is None:
        return {}
    priors = {
        "resistance": (adaptive.resistance, adaptive.resistance_std),
        "inverter_voltage": (adaptive.inverter_voltage, adaptive.inverter_std),
        "psi_f": (adaptive.psi_f, adaptive.psi_f_std),
    }
    return {name: value for name, (value, std) in priors.items() if std > 0}


def _layout(learnt: dict[str, float], budget: tuple[str, ...]) -> Any:
    """Return a mosaic of six columns, in which one, two or three panels can share a row."""
    mosaic = [
        ["locus"] * 2 + ["position"] * 4,
        ["locus"] * 2 + ["error"] * 4,
        ["speed"] * 6,
        ["drift"] * 6,
        *([name] * 6 for name in budget),
    ]
    if learnt:
        mosaic.append([name for name in learnt for _ in range(6 // len(learnt))])
    return mosaic


def _numbers(result: LogRun, fit: TruthFit | None) -> str:
    """Return the second line of the title."""
    statistics = result.statistics
    if not statistics.valid:
        return "\nno valid position: see the summary"
    psi = 1e3 * statistics.mean("psi_f")
    text = f"\nlag {signed(result.log.layout.lag)}  ·  |λ - L i| = {psi:.3g} mWb"
    if statistics.scored:
        corrected = fit is not None and fit.angular
        rms = fit.rms if fit is not None and corrected else statistics.rms_error
        text += f"  ·  position error {np.degrees(rms):.2f}° rms on valid rows"
        text += ", without the encoder's errors" if corrected else ""
    return text


def _blank_invalid(series: dict[str, Array], name: str) -> Array:
    return np.where(series["valid"] > 0, series[name], np.nan)


def _locus(axes: Axes, columns: dict[str, Array]) -> None:
    valid = columns["valid"] > 0
    scale, unit = (1e3, "mWb") if np.abs(columns["psi_f"]).max(initial=0) < 0.5 else (1.0, "Wb")
    axes.plot(
        scale * columns["flux_alpha"][valid],
        scale * columns["flux_beta"][valid],
        ".",
        color=BLUE,
        markersize=1.5,
        label="λ",
    )
    x = scale * columns["psi_f"] * np.cos(columns["theta_e"])
    y = scale * columns["psi_f"] * np.sin(columns["theta_e"])
    axes.plot(x[valid], y[valid], ".", color=ORANGE, markersize=1.5, label="λ - L i, along d")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title("Flux locus")
    axes.set_xlabel(f"α [{unit}]")
    axes.set_ylabel(f"β [{unit}]")
    legend(axes, markerscale=5)


def _set_title(axes: Axes, text: str, short: str) -> None:
    """Set the title; printed pictures get the short title, to leave room for the legend."""
    figure: Any = axes.figure
    axes.set_title(text if figure.get_figwidth() > PRINTED else short)


def _position(axes: Axes, detail: dict[str, Array]) -> None:
    _set_title(axes, "Position around the first valid row", "Position at the start")
    axes.set_ylabel("θ_e [°]")
    if not detail:
        axes.text(0.5, 0.5, "no valid position", ha="center", transform=axes.transAxes)
        return
    detail = _few_periods(detail)
    t = detail["t"]
    if "truth" in detail:
        axes.plot(t, _degrees_with_gaps(detail["truth"]), color=GREY, linewidth=3, label="true")
    axes.plot(t, _degrees_with_gaps(detail["theta_e"]), color=BLUE, label="estimated")
    axes.set_ylim(-190, 190)
    axes.set_yticks([-180, -90, 0, 90, 180])
    axes.set_xlim(t[0], t[-1])
    axes.set_xlabel("t [s]")
    _shade_invalid(axes, detail)
    legend(axes)


def _few_periods(detail: dict[str, Array], periods: float = 8.0) -> dict[str, Array]:
    """Return the rows from shortly before the first valid row to a few turns after it."""
    first_valid = int(np.argmax(detail["valid"] > 0))
    turned = np.abs(np.unwrap(detail["theta_e"][first_valid:]) - detail["theta_e"][first_valid])
    later = turned > periods * 2 * np.pi
    stop = first_valid + int(np.argmax(later)) if later.any() else None
    start = 0 if stop is None else max(0, first_valid - (stop - first_valid))
    return {name: values[start:stop] for name, values in detail.items()}


def _degrees_with_gaps(angle: Array) -> Array:
    """Convert to degrees, with a gap where the angle wraps."""
    degrees = np.degrees(angle)
    degrees[1:][np.abs(np.diff(degrees)) > 180] = np.nan
    return np.asarray(degrees)


def _scored(series: dict[str, Array], fit: TruthFit | None) -> dict[str, Array]:
    """Return the columns, with truth and position error corrected by the fit."""
    if fit is None or not fit.angular or "raw" not in series:
        return series
    error = fit.error(series["theta_e"], series["raw"], series["speed_e"])
    return series | {"theta_e_error": error, "truth": series["theta_e"] - error}


def _marks(axes: Axes, result: LogRun) -> None:
    """Draw a strip for each mark of a fault along the lower edge."""
    marked = result.statistics.quality.marked
    names = [mark.name for mark in MARKS if mark.fault and mark.name in marked]
    statistics, h = result.statistics, result.log.sample_time
    shortest = max(h, STRIP_SHARE * statistics.rows * h)  # a single row must be visible
    for n, name in enumerate(names):
        place = STRIP * (n + 0.5)
        for start, end in marked[name].stretches:
            axes.plot(
                [start, max(end, start + shortest)],
                [place, place],
                transform=axes.get_xaxis_transform(),
                color=LAYERS[n % len(LAYERS)],
                linewidth=3,
                solid_capstyle="butt",
                label=name if start == marked[name].stretches[0][0] else None,
            )
    if names:
        legend(axes)


def _gaps(axes: Axes, result: LogRun) -> None:
    """Mark the gaps in the log."""
    times = result.log.clock.t[1:]
    for n, t in enumerate(times[:: max(1, len(times) // GAPS_SHOWN)]):
        axes.axvline(t, color=RED, linewidth=0.8, label="gap in the log" if n == 0 else None)
    if len(times):
        legend(axes)


def _error(axes: Axes, columns: dict[str, Array], fit: TruthFit | None = None) -> None:
    t, band = columns["t"], 2 * np.degrees(_blank_invalid(columns, "theta_e_std"))
    axes.fill_between(t, -band, band, color=BLUE, alpha=0.18, linewidth=0, label="±2σ")
    if "theta_e_error" in columns:
        axes.plot(
            t, np.degrees(_blank_invalid(columns, "theta_e_error")), color=BLUE, label="error"
        )
    axes.axhline(0, color=GREY, linewidth=0.5)
    limit = np.nanpercentile(band, 99) if np.isfinite(band).any() else 10.0
    if "theta_e_error" in columns:
        error = np.abs(np.degrees(_blank_invalid(columns, "theta_e_error")))
        limit = max(limit, np.nanpercentile(error, 99.5) if np.isfinite(error).any() else 0.0)
    axes.set_ylim(-1.4 * limit, 1.4 * limit)
    title = "Position error" if "theta_e_error" in columns else "Uncertainty of the position"
    corrected = fit is not None and fit.angular and fit.told
    axes.set_title(title + (" against the corrected truth" if corrected else ""))
    axes.set_ylabel("[°]")
    legend(axes)


def scaled(factor: float) -> Callable[[Any], Any]:
    """Return a function that multiplies by a factor."""
    return lambda values: factor * values


def _speed(axes: Axes, columns: dict[str, Array], n_p: int) -> None:
    axes.plot(columns["t"], _blank_invalid(columns, "speed_e"), color=BLUE)
    rpm = RPM / n_p
    right = axes.secondary_yaxis("right", functions=(scaled(rpm), scaled(1 / rpm)))
    right.set_ylabel("rpm")
    axes.axhline(0, color=GREY, linewidth=0.5)
    axes.set_title("Speed")
    axes.set_ylabel("ω_e [rad/s]")


def _drift(axes: Axes, columns: dict[str, Array]) -> None:
    for name, color, label in (("drift_alpha", BLUE, "α"), ("drift_beta", ORANGE, "β")):
        axes.plot(columns["t"], 1e3 * _blank_invalid(columns, name), color=color, label=label)
    axes.axhline(0, color=GREY, linewidth=0.5)
    _set_title(
        axes,
        "Drift R δ_i - δ_u: rate at which sensor offsets move the flux integral",
        "Drift R δ_i - δ_u, from offsets",
    )
    axes.set_ylabel("[mV]")
    legend(axes)


def _budget(axes: Axes, result: LogRun) -> None:
    """Stack the contributions to the variance of the position over time, the largest below."""
    assert result.budget is not None
    t, names, layers = result.budget.layers(BUDGET_LAYERS)
    axes.set_title("Error budget of the position: variance by cause")
    axes.set_ylabel("σ² [°²]")
    if not names:
        axes.text(0.5, 0.5, "no valid position", ha="center", transform=axes.transAxes)
        return
    factor = float(np.degrees(1.0)) ** 2
    layers = [factor * layer for layer in layers]
    total = np.sum(layers, axis=0)
    axes.stackplot(t, *layers, labels=names, colors=LAYERS, linewidth=0)
    axes.set_ylim(0, 1.05 * float(np.nanmax(total)))
    legend(axes, ncols=3)


def _parameter(axes: Axes, name: str, columns: dict[str, Array], assumed: float) -> None:
    """Plot the estimate with its ±2σ band, and the assumed value."""
    title, unit = PARAMETERS[name]
    value, std = columns[name].copy(), columns[f"{name}_std"]
    not_adapting = columns["adapting"] == 0  # psi_f is then the length of λ - L i
    value[not_adapting] = np.nan
    axes.fill_between(
        columns["t"],
        value - 2 * std,
        value + 2 * std,
        color=BLUE,
        alpha=0.18,
        linewidth=0,
        label="±2σ",
    )
    axes.plot(columns["t"], value, color=BLUE)
    axes.axhline(assumed, color=ORANGE, linewidth=0.8, linestyle="--", label="assumed")
    axes.set_title(title)
    axes.set_ylabel(f"[{unit}]")
    legend(axes)


def _shade_invalid(axes: Axes, series: dict[str, Array]) -> None:
    invalid: Any = series["valid"] == 0
    axes.fill_between(
        series["t"],
        0,
        1,
        where=invalid,
        color="0.88",
        linewidth=0,
        step="mid",
        transform=axes.get_xaxis_transform(),
        zorder=0,
    )


def _immersed(result: LogRun) -> Figure:
    """Draw flux with ±2σ, position, drift, and current bias or noise share."""
    columns = result.statistics.thin.columns()
    t, ports, position = columns["t"], result.machine.ports, result.machine.position_output
    angle = position.unit == "°"
    figure = new_figure(figsize=(9, 9))
    axes = figure.subplots(4, 1, sharex=True)
    _pair(axes[0], columns, "flux", ports, 1e3 if angle else 1e6)
    axes[0].set_title(f"Flux [{'mWb' if angle else 'µWb'}], band ±2σ")
    axes[1].plot(t, position.factor * _blank_invalid(columns, position.name), color=BLUE)
    axes[1].set_title(f"{position.title} [{position.unit.strip()}]")
    _pair(axes[2], columns, "drift", ports)
    axes[2].set_title("Drift [V]")
    if f"current_bias_{ports[0]}" in columns:
        _pair(axes[3], columns, "current_bias", ports)
        axes[3].set_title("Current bias [A], band ±2σ")
    else:
        axes[3].semilogy(t, np.maximum(columns["noise_share"], 1e-12), color=GREY)
        axes[3].set_title("Noise share of the flux information; valid below 0.1")
    axes[3].set_xlabel("t [s]")
    axes[3].set_xlim(t[0], t[-1])
    figure.suptitle(_title(result), fontsize=10)
    return figure


def _pair(
    axes: Axes, columns: dict[str, Array], name: str, ports: tuple[str, str], factor: float = 1.0
) -> None:
    """Plot both components of a vector, with ±2σ bands if it has standard deviations."""
    for port, colour in zip(ports, (BLUE, ORANGE), strict=True):
        column = f"{name}_{port}"
        value = factor * _blank_invalid(columns, column)
        axes.plot(columns["t"], value, color=colour, label=port)
        if f"{column}_std" in columns:
            band = 2 * factor * columns[f"{column}_std"]
            axes.fill_between(
                columns["t"], value - band, value + band, color=colour, alpha=0.2, linewidth=0
            )
    legend(axes)
