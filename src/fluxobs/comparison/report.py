"""Reports a comparison as a table, a verdict, CSV and pictures."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core import html
from ..core.output import write_text
from ..core.plots import BLUE, GREY, ORANGE, STYLE, plain, write
from .compare import LANES, Comparison, ObserverResult
from .scoring import Score

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from rich.table import Table

LEAST_SQUARES = "least squares"
#: Within this factor of the best counts as equally good.
NEAR = 1.1


def ours(comparison: Comparison) -> ObserverResult:
    """The better of the least squares' two angles, raw and tracked."""
    both = [r for r in comparison.results if r.name.startswith(LEAST_SQUARES)]
    return min(both, key=lambda result: result.tuned.rms)


def others(comparison: Comparison) -> list[ObserverResult]:
    """Results of all other observers, best first."""
    rest = [r for r in comparison.results if not r.name.startswith(LEAST_SQUARES)]
    return sorted(rest, key=lambda result: result.tuned.rms)


def verdict(comparison: Comparison) -> str:
    """Compares the least squares with the best observer and with the bound, and says why."""
    mine, best = ours(comparison), comparison.best
    rms = np.degrees(mine.tuned.rms)
    text = f"The least squares has {_degrees(rms)} rms"
    if comparison.bound is not None:
        raw = comparison.result(LEAST_SQUARES).tuned.rms
        text += (
            f"; untracked {raw / comparison.bound:.2f} times the Cramér-Rao bound, "
            f"{_degrees(np.degrees(comparison.bound))}, for an angle without a motion model"
        )
    text += _claims(comparison.result(LEAST_SQUARES).recommended)
    if mine.tuned.rms <= NEAR * best.tuned.rms:
        if best is mine:
            for second in others(comparison)[:1]:
                text += f" It is the best, before {second.name}, {_rms(second.tuned)}."
        else:
            text += f" It is within 10 % of the best, {best.name}, {_rms(best.tuned)}."
        return text
    text += f" The best is {best.name}, {_rms(best.tuned)}"
    return text + (f": {comparison.limit}." if comparison.limit else ".")


def _claims(default: Score) -> str:
    """Share of rows that the observer calls valid with its default memory, and its error there."""
    text = f". With its default memory it calls {default.claimed:.0%} of the scored rows valid"
    if default.claimed:
        text += f" and is at most {_degrees(np.degrees(default.worst_claimed))} off there"
    return text + "."


def _number(value: float) -> str:
    return f"{value:.3f}" if value < 1 else f"{value:.3g}"


def _rms(score: Score) -> str:
    return _degrees(np.degrees(score.rms))


def _degrees(value: float) -> str:
    return f"{value:.3f}°" if value < 1 else f"{value:.2f}°"


#: Heads of the table; the first column names the observer.
HEADS = (
    *("observer", "usual\nrms [°]", "tuned\nrms [°]", "max\n[°]", "speed\n[rad/s]"),
    *("flux\n[% ψ]", "settled\n[ms]", "lost\n[%]", "time\n[ns]"),
)


def _caption(comparison: Comparison) -> str:
    return (
        f"{comparison.about}. Gains as usually recommended, and tuned for this record; settled: "
        f"first 50 ms below 10°; time: per sample in JAX, {LANES} settings at once"
    )


def cells(comparison: Comparison) -> list[list[str]]:
    """The table's rows, best first."""
    out = []
    for result in sorted(comparison.results, key=lambda r: r.tuned.rms):
        tuned = result.tuned
        out.append(
            [
                result.name,
                _number(np.degrees(result.recommended.rms)),
                _number(np.degrees(tuned.rms)),
                _number(np.degrees(tuned.worst)),
                "" if tuned.speed is None else f"{tuned.speed:.2f}",
                "" if tuned.flux is None else f"{100 * tuned.flux / comparison.psi:.2f}",
                "never" if np.isnan(tuned.settled) else f"{1e3 * tuned.settled:.0f}",
                f"{100 * tuned.lost:.1f}" if tuned.lost else "",
                f"{1e9 * result.time:.0f}",
            ]
        )
    return out


def table(comparison: Comparison) -> Table:
    """Table for a terminal, best first."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    out = Table(title=comparison.title, caption=_caption(comparison), box=box.SIMPLE, expand=False)
    out.add_column(HEADS[0], no_wrap=True)
    for name in HEADS[1:]:
        out.add_column(Text(name), justify="right", no_wrap=True)  # [ms] is no markup
    for row in cells(comparison):
        out.add_row(*row, style="bold" if row[0].startswith(LEAST_SQUARES) else None)
    return out


def write_html(comparisons: Sequence[Comparison], pictures: Sequence[Path], path: Path) -> None:
    """Write tables, verdicts and pictures as one page.

    Parameters
    ----------
    comparisons : sequence of Comparison
    pictures : sequence of Path
        PNG files: one of each comparison, then perhaps that of all of them.
    path : Path
    """
    parts = []
    for comparison, picture in zip(comparisons, pictures, strict=False):
        words = verdict(comparison)
        parts += [
            html.table(HEADS, cells(comparison), f"{comparison.title}. {_caption(comparison)}"),
            html.paragraph(words),
            html.image(picture.read_bytes(), words),
        ]
    for picture in pictures[len(comparisons) :]:
        parts.append(
            html.image(picture.read_bytes(), "Tuned errors of all observers on all records")
        )
    write_text(path, html.document("Observers compared", *parts))


COLUMNS = (
    "record",
    "observer",
    "gains",
    "settings",
    "rms_deg",
    "largest_deg",
    "speed_rms_rad_s",
    "flux_rms_Wb",
    "below_10_deg_after_s",
    "lost_share",
    "bound_rms_deg",
    "ns_a_sample",
)


def write_csv(comparisons: Sequence[Comparison], path: Path) -> None:
    """Writes all scores, two rows per observer: recommended and tuned gains."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(COLUMNS)
    for c in comparisons:
        for result in c.results:
            for which, score, gains in (
                ("recommended", result.recommended, result.recommended_gains),
                ("tuned", result.tuned, result.gains),
            ):
                rows.writerow(
                    [
                        c.title,
                        result.name,
                        which,
                        " ".join(f"{key}={value:.4g}" for key, value in gains.items()),
                        f"{np.degrees(score.rms):.5g}",
                        f"{np.degrees(score.worst):.5g}",
                        "" if score.speed is None else f"{score.speed:.5g}",
                        "" if score.flux is None else f"{score.flux:.5g}",
                        "" if np.isnan(score.settled) else f"{score.settled:.5g}",
                        f"{score.lost:.5g}",
                        "" if c.bound is None else f"{np.degrees(c.bound):.5g}",
                        f"{1e9 * result.time:.0f}",
                    ]
                )
    write_text(path, text.getvalue())


def draw(comparison: Comparison, path: Path) -> None:
    """Draws the rms errors as bars; in time, the errors of the least squares and the best other."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    results = sorted(comparison.results, key=lambda r: -r.tuned.rms)
    with plt.rc_context(STYLE):
        figure = plt.figure(figsize=(11, 5), layout="constrained")
        bars, course = figure.subplots(1, 2, width_ratios=[1, 1.2])
        _bars(bars, results, comparison.bound)
        _course(course, comparison)
        figure.suptitle(
            f"{plain(comparison.title)}  ·  {comparison.setting.machine.kind}", fontsize=10
        )
        write(figure, path)
        plt.close(figure)


def _bars(axes: Axes, results: Sequence[ObserverResult], bound: float | None) -> None:
    at = np.arange(len(results))
    tuned = np.degrees([r.tuned.rms for r in results])
    recommended = np.degrees([r.recommended.rms for r in results])
    colors = [BLUE if r.name.startswith(LEAST_SQUARES) else GREY for r in results]
    least = min(tuned.min(), 0.05) / 2
    axes.barh(at, tuned - least, left=least, color=colors, height=0.6, label="gains tuned here")
    axes.plot(recommended, at, "|", color=ORANGE, markersize=11, markeredgewidth=2)
    axes.plot([], [], "|", color=ORANGE, markersize=9, markeredgewidth=2, label="usual gains")
    if bound is not None:
        axes.axvline(np.degrees(bound), color="black", linewidth=0.8, linestyle=":")
        axes.plot([], [], ":", color="black", linewidth=0.8, label="bound for a raw angle")
    for k, value in enumerate(tuned):
        axes.text(least, k, f" {value:.2g}", va="center", color="white", fontsize=7)
    axes.set_xscale("log")
    axes.set_xlim(least, 2.5 * max(tuned.max(), recommended.max()))
    axes.set_yticks(at, [r.name for r in results], fontsize=8)
    axes.set_xlabel("position error, rms [°]")
    axes.legend(fontsize=7, loc="lower right", bbox_to_anchor=(1, 1), ncols=3)


def _course(axes: Axes, comparison: Comparison) -> None:
    t = comparison.truth.t
    mine = ours(comparison)
    shown = [*others(comparison)[:3][::-1], mine]
    colors = ["#9ecae1", ORANGE, "#7b9e5b", BLUE]
    step = max(1, len(t) // 4000)
    for result, color in zip(shown, colors[-len(shown) :], strict=True):
        error = np.degrees(result.error)[::step]
        error[1:][np.abs(np.diff(error)) > 180] = np.nan  # no line where the angle wraps
        axes.plot(t[::step], error, color=color, label=result.name)
    reach = max(r.tuned.worst for r in shown)
    axes.set_ylim(-1.2 * np.degrees(reach), 1.2 * np.degrees(reach))
    axes.axvspan(t[0], comparison.truth.score_from, color="0.9", linewidth=0)
    axes.set_xlim(t[0], t[-1])
    axes.set_xlabel("t [s]        grey: not scored")
    axes.set_ylabel("position error [°]")
    axes.legend(fontsize=7, loc="lower right", bbox_to_anchor=(1, 1), ncols=2)


def draw_summary(comparisons: Sequence[Comparison], path: Path) -> None:
    """Draws observers over records, with tuned rms errors as colours and numbers."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.colors import LogNorm

    names = [r.name for r in comparisons[0].results]
    values = np.array([[np.degrees(c.result(n).tuned.rms) for c in comparisons] for n in names])
    with plt.rc_context(STYLE):
        width = max(7.0, 3.2 + 0.42 * len(comparisons))
        figure, axes = plt.subplots(figsize=(width, 4.6), layout="constrained")
        norm: Any = LogNorm(0.03, 60)
        picture = axes.imshow(values, norm=norm, cmap="YlOrBr", aspect="auto")
        best = values.min(axis=0)
        for row, line in enumerate(values):
            for column, value in enumerate(line):
                near = value <= NEAR * best[column]
                axes.text(
                    column,
                    row,
                    f"{value:.2f}" if value < 10 else f"{value:.0f}",
                    ha="center",
                    va="center",
                    fontsize=6.5,
                    fontweight="bold" if near else "normal",
                    color="white" if value > 5 else "black",
                )
        axes.set_yticks(range(len(names)), names, fontsize=8)
        axes.set_xticks(
            range(len(comparisons)),
            [c.title for c in comparisons],
            rotation=40,
            ha="right",
            rotation_mode="anchor",
            fontsize=8,
        )
        axes.tick_params(length=0)
        for spine in axes.spines.values():
            spine.set_visible(False)
        figure.colorbar(picture, ax=axes, label="position error, rms [°]", pad=0.01)
        axes.set_title("Gains tuned for every record; bold: best or within 10 % of it")
        write(figure, path)
        plt.close(figure)
