"""The picture of a run. Matplotlib is loaded only when one is asked for."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .errors import FluxobsError
from .estimate import Result
from .writing import check_place

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

BLUE, ORANGE, GREY = "#1f5fa8", "#d9762b", "#8a8a8a"
GREY_WORDS = "        grey: position not known"
#: Title and unit of what the adaptive observer finds.
PARAMETERS = {
    "resistance": ("Resistance", "Ω"),
    "inverter_voltage": ("Inverter", "V"),
    "psi_f": ("Magnet flux", "Wb"),
}
FORMATS = (".png", ".pdf", ".svg")
STYLE: Any = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "legend.frameon": False,
    "lines.linewidth": 1.0,
}


def report(result: Result, path: str | Path) -> None:
    """Writes the picture of a run: flux locus, position with its ±2σ band, speed, drift.

    Raises
    ------
    FluxobsError
        The ending is none of .png, .pdf, .svg, or the file cannot be written.
    """
    path = Path(path)
    check_path(path)
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    with plt.rc_context(STYLE):
        learnt = _learnt(result)
        figure = plt.figure(figsize=(11, 10.5 if learnt else 8.5), layout="constrained")
        layout = _layout(learnt)
        axes = figure.subplot_mosaic(layout, height_ratios=[1.2, *[1.0] * (len(layout) - 1)])
        whole, detail = result.tally.thin.columns(), result.tally.detail.columns()
        _locus(axes["locus"], whole)
        _position(axes["position"], detail)
        _error(axes["error"], whole)
        _speed(axes["speed"], whole)
        _drift(axes["drift"], whole)
        for name in learnt:
            _parameter(axes[name], name, whole, learnt[name])
        for name in ("error", "speed", "drift", *learnt):
            _shade_unknown(axes[name], whole)
            axes[name].set_xlim(whole["t"][0], whole["t"][-1])
        axes["error"].set_xlabel("t [s]")
        axes["speed"].sharex(axes["drift"])
        axes["speed"].tick_params(labelbottom=False)
        axes["drift"].set_xlabel("" if learnt else f"t [s]{GREY_WORDS}")
        for name in learnt:
            axes[name].set_xlabel(f"t [s]{GREY_WORDS if name == next(iter(learnt)) else ''}")
        figure.suptitle(
            f"{result.log.table.path.name}  ·  {result.machine.kind}  ·  position valid on "
            f"{result.tally.valid / result.tally.rows:.1%} of {result.tally.rows} rows"
            f"{_numbers(result)}",
            fontsize=10,
        )
        write(figure, path)
        plt.close(figure)


def _learnt(result: Result) -> dict[str, float]:
    """Columns of what the adaptive observer finds → what was believed."""
    adaptive = result.adaptive
    if adaptive is None:
        return {}
    believed = {
        "resistance": (adaptive.resistance, adaptive.resistance_std),
        "inverter_voltage": (adaptive.inverter_voltage, adaptive.inverter_std),
        "psi_f": (adaptive.psi_f, adaptive.psi_f_std),
    }
    return {name: value for name, (value, std) in believed.items() if std > 0}


def _layout(learnt: dict[str, float]) -> Any:
    """Six columns, so that one, two or three panels share a row."""
    rows = [
        ["locus"] * 2 + ["position"] * 4,
        ["locus"] * 2 + ["error"] * 4,
        ["speed"] * 6,
        ["drift"] * 6,
    ]
    if learnt:
        rows.append([name for name in learnt for _ in range(6 // len(learnt))])
    return rows


def write(figure: Figure, path: Path) -> None:
    """Saves a figure: complete or not at all, the same bytes on every run."""
    import matplotlib as mpl

    temporary = path.with_name(f".{path.name}.part{path.suffix}")
    stamp: dict[str, Any] = {".png": {}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    try:
        with mpl.rc_context({"svg.hashsalt": "fluxobs"}):
            figure.savefig(temporary, dpi=130, metadata=stamp[path.suffix.lower()])
        os.replace(temporary, path)
    except OSError as error:
        raise FluxobsError(f"{path}: cannot be written: {error.strerror}") from None
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


def _numbers(result: Result) -> str:
    """Second line of the title."""
    tally = result.tally
    if not tally.valid:
        return "\nthe position was never known: see the summary"
    psi = 1e3 * tally.psi / tally.valid
    text = f"\nlag {result.log.layout.lag:g}  ·  |λ - L i| = {psi:.3g} mWb"
    if tally.scored:
        rms = np.degrees(np.sqrt(tally.error_squared / tally.scored))
        text += f"  ·  position error {rms:.2f}° rms on valid rows"
    return text


def check_path(path: Path) -> None:
    """Refuses early what could not be written at the end."""
    if path.suffix.lower() not in FORMATS:
        raise FluxobsError(f"{path}: --report must end in {', '.join(FORMATS)}")
    check_place(path)


def legend(axes: Axes, **options: Any) -> None:
    """Above the axes at the right, where no data can be."""
    axes.legend(loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0, ncols=2, **options)


def _where_valid(series: dict[str, Array], name: str) -> Array:
    return np.where(series["valid"] > 0, series[name], np.nan)


def _locus(axes: Axes, whole: dict[str, Array]) -> None:
    known = whole["valid"] > 0
    scale, unit = (1e3, "mWb") if np.abs(whole["psi_f"]).max(initial=0) < 0.5 else (1.0, "Wb")
    axes.plot(
        scale * whole["flux_alpha"][known],
        scale * whole["flux_beta"][known],
        ".",
        color=BLUE,
        markersize=1.5,
        label="λ",
    )
    x = scale * whole["psi_f"] * np.cos(whole["theta_e"])
    y = scale * whole["psi_f"] * np.sin(whole["theta_e"])
    axes.plot(x[known], y[known], ".", color=ORANGE, markersize=1.5, label="λ - L i, along d")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title("Flux locus")
    axes.set_xlabel(f"α [{unit}]")
    axes.set_ylabel(f"β [{unit}]")
    legend(axes, markerscale=5)


def _position(axes: Axes, detail: dict[str, Array]) -> None:
    axes.set_title("Position around the first valid row")
    axes.set_ylabel("θ_e [°]")
    if not detail:
        axes.text(0.5, 0.5, "the position was never known", ha="center", transform=axes.transAxes)
        return
    detail = _few_periods(detail)
    t = detail["t"]
    if "truth" in detail:
        axes.plot(t, _degrees_unjoined(detail["truth"]), color=GREY, linewidth=3, label="true")
    axes.plot(t, _degrees_unjoined(detail["theta_e"]), color=BLUE, label="estimated")
    axes.set_ylim(-190, 190)
    axes.set_yticks([-180, -90, 0, 90, 180])
    axes.set_xlim(t[0], t[-1])
    axes.set_xlabel("t [s]")
    _shade_unknown(axes, detail)
    legend(axes)


def _few_periods(detail: dict[str, Array], periods: float = 8.0) -> dict[str, Array]:
    """From some way before the first valid row until it has turned a few times."""
    at = int(np.argmax(detail["valid"] > 0))
    turned = np.abs(np.unwrap(detail["theta_e"][at:]) - detail["theta_e"][at])
    far = turned > periods * 2 * np.pi
    stop = at + int(np.argmax(far)) if far.any() else None
    start = 0 if stop is None else max(0, at - (stop - at))
    return {name: values[start:stop] for name, values in detail.items()}


def _degrees_unjoined(angle: Array) -> Array:
    """Degrees, with a gap where the angle wraps."""
    out = np.degrees(angle)
    out[1:][np.abs(np.diff(out)) > 180] = np.nan
    return np.asarray(out)


def _error(axes: Axes, whole: dict[str, Array]) -> None:
    t, band = whole["t"], 2 * np.degrees(_where_valid(whole, "theta_e_std"))
    axes.fill_between(t, -band, band, color=BLUE, alpha=0.18, linewidth=0, label="±2σ")
    if "theta_e_error" in whole:
        axes.plot(t, np.degrees(_where_valid(whole, "theta_e_error")), color=BLUE, label="error")
    axes.axhline(0, color=GREY, linewidth=0.5)
    limit = np.nanpercentile(band, 99) if np.isfinite(band).any() else 10.0
    if "theta_e_error" in whole:
        error = np.abs(np.degrees(_where_valid(whole, "theta_e_error")))
        limit = max(limit, np.nanpercentile(error, 99.5) if np.isfinite(error).any() else 0.0)
    axes.set_ylim(-1.4 * limit, 1.4 * limit)
    axes.set_title("Position error" if "theta_e_error" in whole else "Uncertainty of the position")
    axes.set_ylabel("[°]")
    legend(axes)


def _speed(axes: Axes, whole: dict[str, Array]) -> None:
    axes.plot(whole["t"], _where_valid(whole, "speed_e"), color=BLUE)
    axes.axhline(0, color=GREY, linewidth=0.5)
    axes.set_title("Speed")
    axes.set_ylabel("ω_e [rad/s]")


def _drift(axes: Axes, whole: dict[str, Array]) -> None:
    for name, color, label in (("drift_alpha", BLUE, "α"), ("drift_beta", ORANGE, "β")):
        axes.plot(whole["t"], 1e3 * _where_valid(whole, name), color=color, label=label)
    axes.axhline(0, color=GREY, linewidth=0.5)
    axes.set_title("Drift: R δ_i - δ_u, what the sensors' offsets add to the flux per second")
    axes.set_ylabel("[mV]")
    legend(axes)


def _parameter(axes: Axes, name: str, whole: dict[str, Array], believed: float) -> None:
    """What was found, with its ±2σ band, and what the machine file says."""
    title, unit = PARAMETERS[name]
    value, std = whole[name].copy(), whole[f"{name}_std"]
    before = whole["adapting"] == 0  # psi_f is then the length of λ - L i
    value[before] = np.nan
    axes.fill_between(
        whole["t"],
        value - 2 * std,
        value + 2 * std,
        color=BLUE,
        alpha=0.18,
        linewidth=0,
        label="±2σ",
    )
    axes.plot(whole["t"], value, color=BLUE)
    axes.axhline(believed, color=ORANGE, linewidth=0.8, linestyle="--", label="assumed")
    axes.set_title(title)
    axes.set_ylabel(f"[{unit}]")
    legend(axes)


def _shade_unknown(axes: Axes, series: dict[str, Array]) -> None:
    unknown: Any = series["valid"] == 0
    axes.fill_between(
        series["t"],
        0,
        1,
        where=unknown,
        color="0.88",
        linewidth=0,
        step="mid",
        transform=axes.get_xaxis_transform(),
        zorder=0,
    )
