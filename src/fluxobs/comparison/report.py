"""Reports of a comparison: table, verdict, CSV and pictures."""

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
#: An error within this factor of the smallest error counts as equally good.
NEAR = 1.1


def least_squares_result(comparison: Comparison) -> ObserverResult:
    """Return the better of the least squares' two angles, untracked and tracked."""
    both_angles = [r for r in comparison.results if r.name.startswith(LEAST_SQUARES)]
    return min(both_angles, key=lambda result: result.tuned.rms)


def other_results(comparison: Comparison) -> list[ObserverResult]:
    """Return the results of all other observers, best first."""
    results = [r for r in comparison.results if not r.name.startswith(LEAST_SQUARES)]
    return sorted(results, key=lambda result: result.tuned.rms)


def verdict(comparison: Comparison) -> str:
    """Compare the least squares with the best observer and the bound; explain a difference."""
    least_squares, best = least_squares_result(comparison), comparison.best
    rms = np.degrees(least_squares.tuned.rms)
    text = f"The least squares has {_degrees(rms)} rms"
    if comparison.bound is not None:
        untracked_rms = comparison.result(LEAST_SQUARES).tuned.rms
        text += (
            f"; its untracked angle has {untracked_rms / comparison.bound:.2f} times the "
            f"Cramér-Rao bound of {_degrees(np.degrees(comparison.bound))} for an angle without "
            "a motion model"
        )
    text += _describe_validity(comparison.result(LEAST_SQUARES).recommended)
    if least_squares.tuned.rms <= NEAR * best.tuned.rms:
        if best is least_squares:
            for runner_up in other_results(comparison)[:1]:
                text += (
                    f" The least squares is the best observer; the second best is "
                    f"{runner_up.name} with {_rms(runner_up.tuned)}."
                )
        else:
            text += f" The best is {best.name} with {_rms(best.tuned)}, at most 10 % better."
        return text
    text += f" The best is {best.name} with {_rms(best.tuned)}"
    return text + (f": {comparison.limit}." if comparison.limit else ".")


def _describe_validity(default: Score) -> str:
    """State the share of valid rows and the largest valid error, with the default memory."""
    text = f". With its default memory, {default.claimed:.0%} of the scored rows are valid"
    if default.claimed:
        text += f", with errors up to {_degrees(np.degrees(default.worst_claimed))}"
    return text + "."


def _number(value: float) -> str:
    return f"{value:.3f}" if value < 1 else f"{value:.3g}"


def _rms(score: Score) -> str:
    return _degrees(np.degrees(score.rms))


def _degrees(value: float) -> str:
    return f"{value:.3f}°" if value < 1 else f"{value:.2f}°"


#: Headings of the table; the first column names the observer.
HEADS = (
    *("observer", "usual\nrms [°]", "tuned\nrms [°]", "max\n[°]", "speed\n[rad/s]"),
    *("flux\n[% ψ]", "settled\n[ms]", "lost\n[%]", "time\n[ns]"),
)


def _caption(comparison: Comparison) -> str:
    return (
        f"{comparison.about}. Gains are usual or tuned for this record. Settled: first 50 ms below "
        f"10°. Time: per sample in JAX with {LANES} settings at once"
    )


def table_lines(comparison: Comparison) -> list[list[str]]:
    """Return the lines of the table, best observer first."""
    lines = []
    for result in sorted(comparison.results, key=lambda r: r.tuned.rms):
        tuned = result.tuned
        lines.append(
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
    return lines


def table(comparison: Comparison) -> Table:
    """Return the table for the terminal, best observer first."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    terminal_table = Table(
        title=comparison.title, caption=_caption(comparison), box=box.SIMPLE, expand=False
    )
    terminal_table.add_column(HEADS[0], no_wrap=True)
    for name in HEADS[1:]:
        # As Text, since rich would take [ms] as markup.
        terminal_table.add_column(Text(name), justify="right", no_wrap=True)
    for row in table_lines(comparison):
        terminal_table.add_row(*row, style="bold" if row[0].startswith(LEAST_SQUARES) else None)
    return terminal_table


def write_html(comparisons: Sequence[Comparison], pictures: Sequence[Path], path: Path) -> None:
    """Write tables, verdicts and pictures as one page.

    Parameters
    ----------
    comparisons : sequence of Comparison
    pictures : sequence of Path
        PNG files: one per comparison, optionally followed by the summary.
    path : Path
    """
    blocks = []
    for comparison, picture in zip(comparisons, pictures, strict=False):
        conclusion = verdict(comparison)
        blocks += [
            html.table(
                HEADS, table_lines(comparison), f"{comparison.title}. {_caption(comparison)}"
            ),
            html.paragraph(conclusion),
            html.image(picture.read_bytes(), conclusion),
        ]
    for picture in pictures[len(comparisons) :]:
        blocks.append(
            html.image(picture.read_bytes(), "Tuned rms errors of all observers on all records")
        )
    write_text(path, html.document("Observers compared", *blocks))


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
    """Write all scores, two rows per observer: with recommended and with tuned gains."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for c in comparisons:
        for result in c.results:
            for kind, score, gains in (
                ("recommended", result.recommended, result.recommended_gains),
                ("tuned", result.tuned, result.gains),
            ):
                writer.writerow(
                    [
                        c.title,
                        result.name,
                        kind,
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
    """Draw the rms errors as bars, and the errors of the best observers over time."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    results = sorted(comparison.results, key=lambda r: -r.tuned.rms)
    with plt.rc_context(STYLE):
        figure = plt.figure(figsize=(11, 5), layout="constrained")
        bars, course = figure.subplots(1, 2, width_ratios=[1, 1.2])
        _draw_bars(bars, results, comparison.bound)
        _draw_course(course, comparison)
        figure.suptitle(
            f"{plain(comparison.title)}  ·  {comparison.setting.machine.kind}", fontsize=10
        )
        write(figure, path)
        plt.close(figure)


def _draw_bars(axes: Axes, results: Sequence[ObserverResult], bound: float | None) -> None:
    positions = np.arange(len(results))
    tuned = np.degrees([r.tuned.rms for r in results])
    recommended = np.degrees([r.recommended.rms for r in results])
    colors = [BLUE if r.name.startswith(LEAST_SQUARES) else GREY for r in results]
    left_edge = min(tuned.min(), 0.05) / 2
    axes.barh(
        positions,
        tuned - left_edge,
        left=left_edge,
        color=colors,
        height=0.6,
        label="gains tuned here",
    )
    axes.plot(recommended, positions, "|", color=ORANGE, markersize=11, markeredgewidth=2)
    axes.plot([], [], "|", color=ORANGE, markersize=9, markeredgewidth=2, label="usual gains")
    if bound is not None:
        axes.axvline(np.degrees(bound), color="black", linewidth=0.8, linestyle=":")
        axes.plot([], [], ":", color="black", linewidth=0.8, label="bound for a raw angle")
    for k, value in enumerate(tuned):
        axes.text(left_edge, k, f" {value:.2g}", va="center", color="white", fontsize=7)
    axes.set_xscale("log")
    axes.set_xlim(left_edge, 2.5 * max(tuned.max(), recommended.max()))
    axes.set_yticks(positions, [r.name for r in results], fontsize=8)
    axes.set_xlabel("position error, rms [°]")
    axes.legend(fontsize=7, loc="lower right", bbox_to_anchor=(1, 1), ncols=3)


def _draw_course(axes: Axes, comparison: Comparison) -> None:
    t = comparison.truth.t
    least_squares = least_squares_result(comparison)
    shown = [*other_results(comparison)[:3][::-1], least_squares]
    colors = ["#9ecae1", ORANGE, "#7b9e5b", BLUE]
    step = max(1, len(t) // 4000)
    for result, color in zip(shown, colors[-len(shown) :], strict=True):
        error = np.degrees(result.error)[::step]
        error[1:][np.abs(np.diff(error)) > 180] = np.nan  # no line where the angle wraps
        axes.plot(t[::step], error, color=color, label=result.name)
    largest = max(r.tuned.worst for r in shown)
    axes.set_ylim(-1.2 * np.degrees(largest), 1.2 * np.degrees(largest))
    axes.axvspan(t[0], comparison.truth.score_from, color="0.9", linewidth=0)
    axes.set_xlim(t[0], t[-1])
    axes.set_xlabel("t [s]        grey: not scored")
    axes.set_ylabel("position error [°]")
    axes.legend(fontsize=7, loc="lower right", bbox_to_anchor=(1, 1), ncols=2)


def draw_summary(comparisons: Sequence[Comparison], path: Path) -> None:
    """Draw the tuned rms errors of all observers on all records, as colours and numbers."""
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
        for row, errors in enumerate(values):
            for column, value in enumerate(errors):
                is_good = value <= NEAR * best[column]
                axes.text(
                    column,
                    row,
                    f"{value:.2f}" if value < 10 else f"{value:.0f}",
                    ha="center",
                    va="center",
                    fontsize=6.5,
                    fontweight="bold" if is_good else "normal",
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
        axes.set_title("Gains tuned for each record; bold: within 10 % of the best")
        write(figure, path)
        plt.close(figure)
