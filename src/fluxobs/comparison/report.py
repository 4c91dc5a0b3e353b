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
from .compare import ADAPTIVE, LANES, WHOLE_LOG, Comparison, ObserverResult
from .scoring import Score

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from rich.table import Table

LEAST_SQUARES = "least squares"
#: Beginnings of the names of fluxobs' observers, which state the rows that are valid.
OWN = (WHOLE_LOG, ADAPTIVE, LEAST_SQUARES)
#: An error within this factor of the smallest error counts as equally good.
NEAR = 1.1


def least_squares_result(comparison: Comparison) -> ObserverResult:
    """Return the better of the least squares' two angles, untracked and tracked."""
    both_angles = [r for r in comparison.results if r.name.startswith(LEAST_SQUARES)]
    return min(both_angles, key=lambda result: result.tuned.rms)


def other_results(comparison: Comparison) -> list[ObserverResult]:
    """Return the results of the published observers, best first."""
    return [result for result in comparison.ranked if not result.name.startswith(LEAST_SQUARES)]


def verdict(comparison: Comparison) -> str:
    """Compare the observers of fluxobs with the best other and the bound; explain a difference."""
    least_squares, best = least_squares_result(comparison), comparison.best
    rms = np.degrees(least_squares.tuned.rms)
    text = "".join(
        f"{result.name.capitalize()}: {_describe_valid(result.tuned)}. "
        for result in comparison.learnt
    )
    text += f"The least squares, which learns no parameter, has {_degrees(rms)} rms on all rows"
    if comparison.bound is not None:
        untracked_rms = comparison.result(LEAST_SQUARES).tuned.rms
        text += (
            f"; its untracked angle has {untracked_rms / comparison.bound:.2f} times the "
            f"Cramér-Rao bound of {_degrees(np.degrees(comparison.bound))} for an angle without "
            "a motion model"
        )
    default = comparison.result(LEAST_SQUARES).recommended
    text += f". With its default memory: {_describe_valid(default)}."
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
    text += f" The best on all rows, with tuned gains, is {best.name} with {_rms(best.tuned)}"
    return text + (f": {comparison.limit}." if comparison.limit else ".")


def _describe_valid(score: Score) -> str:
    """State the share of valid rows, their rms error and the largest."""
    if not score.claimed:
        return "no scored row is valid"
    rms, worst = _degrees(np.degrees(score.rms_claimed)), _degrees(np.degrees(score.worst_claimed))
    return f"{score.claimed:.1%} of the scored rows are valid, with {rms} rms, {worst} at most"


def _number(value: float) -> str:
    return f"{value:.3f}" if value < 1 else f"{value:.3g}"


def _rms(score: Score) -> str:
    return _degrees(np.degrees(score.rms))


def _degrees(value: float) -> str:
    return f"{value:.3f}°" if value < 1 else f"{value:.2f}°"


#: Headings of the table; the first column names the observer.
HEADS = (
    *("observer", "valid\n[%]", "valid\nrms [°]", "valid\nmax [°]", "usual\nrms [°]"),
    *("tuned\nrms [°]", "max\n[°]", "lost\n[%]", "time\n[ns]"),
)


def _caption(comparison: Comparison) -> str:
    return (
        f"{comparison.about}. Valid: rows that the observer calls valid, and its errors there; the "
        f"other errors are those of all rows. Gains are usual or tuned for this record; whole log "
        f"and adaptive observer have none, they learn the parameters. Time: per sample, "
        f"with {LANES} settings at once in JAX, or in C"
    )


def table_lines(comparison: Comparison) -> list[list[str]]:
    """Return the lines of the table: first those that learn, then the best with tuned gains."""
    lines = []
    for result in (*comparison.learnt, *comparison.ranked):
        tuned = result.tuned
        states = result.name.startswith(OWN)
        valid = [f"{100 * tuned.claimed:.1f}"] if states else ["", "", ""]
        if states:
            valid += [
                _number(np.degrees(tuned.rms_claimed)) if tuned.claimed else "",
                _number(np.degrees(tuned.worst_claimed)) if tuned.claimed else "",
            ]
        lines.append(
            [
                result.name,
                *valid,
                "" if result in comparison.learnt else _number(np.degrees(result.recommended.rms)),
                _number(np.degrees(tuned.rms)),
                _number(np.degrees(tuned.worst)),
                f"{100 * tuned.lost:.1f}" if tuned.lost else "",
                f"{1e9 * result.time:.0f}",
            ]
        )
    return lines


def table(comparison: Comparison) -> Table:
    """Return the table for the terminal."""
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
        terminal_table.add_row(*row, style="bold" if row[0].startswith(OWN) else None)
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
    "valid_share",
    "valid_rms_deg",
    "valid_largest_deg",
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
                        f"{score.claimed:.5g}",
                        f"{np.degrees(score.rms_claimed):.5g}" if score.claimed else "",
                        f"{np.degrees(score.worst_claimed):.5g}" if score.claimed else "",
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

    results = sorted(comparison.results, key=_shown_rms, reverse=True)
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


def _shown_rms(result: ObserverResult) -> float:
    """Return the rms error that a picture shows: of the valid rows if gains are not tuned."""
    learns = result.name in (WHOLE_LOG, ADAPTIVE)
    return result.tuned.rms_claimed if learns and result.tuned.claimed else result.tuned.rms


def _draw_bars(axes: Axes, results: Sequence[ObserverResult], bound: float | None) -> None:
    positions = np.arange(len(results))
    tuned = np.degrees([_shown_rms(r) for r in results])
    recommended = np.degrees([r.recommended.rms for r in results])
    colors = [BLUE if r.name.startswith(OWN) else GREY for r in results]
    left_edge = min(tuned.min(), 0.05) / 2
    axes.barh(
        positions,
        tuned - left_edge,
        left=left_edge,
        color=colors,
        height=0.6,
        label="gains tuned here",
    )
    recommended = np.where([r.name in (WHOLE_LOG, ADAPTIVE) for r in results], tuned, recommended)
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
    axes.set_xlabel("position error, rms [°]; whole log and adaptive: on valid rows")
    axes.legend(fontsize=7, loc="lower right", bbox_to_anchor=(1, 1), ncols=3)


def _draw_course(axes: Axes, comparison: Comparison) -> None:
    t = comparison.truth.t
    least_squares = least_squares_result(comparison)
    shown = [*other_results(comparison)[:2][::-1], least_squares, *comparison.learnt[:1]]
    colors = ["#9ecae1", ORANGE, "#7b9e5b", BLUE]
    step = max(1, len(t) // 4000)
    for result, color in zip(shown, colors[-len(shown) :], strict=True):
        error = np.degrees(result.error)[::step]
        error[1:][np.abs(np.diff(error)) > 180] = np.nan  # no line where the angle wraps
        axes.plot(t[::step], error, color=color, label=result.name)
    largest = max(r.tuned.worst for r in shown if r not in comparison.learnt)
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
    values = np.degrees([[_shown_rms(c.result(n)) for c in comparisons] for n in names])
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
