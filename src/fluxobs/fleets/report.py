"""The report of a fleet: changes as text for the terminal, and as HTML with pictures."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core import html
from ..core.output import write_text
from ..core.plots import BLUE, GREY, ORANGE, STYLE, new_figure, plain
from .batch import Fleet
from .follow import FOLLOWED, Followed, describe_too_few, describe_undated

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Shortest time axis of a picture.
SPAN = np.timedelta64(1, "D").astype("timedelta64[us]")
#: Largest number of drives with a picture; drives with remarks come first.
DRAWN = 40


def headline(fleet: Fleet, followed: Sequence[Followed]) -> str:
    """Describe the fleet in a sentence or two."""
    table = fleet.table
    drives = table["drive"].n_unique()
    times = table["time"].drop_nulls()
    start, end = times.min(), times.max()
    span = ""
    if isinstance(start, datetime) and isinstance(end, datetime):
        span = f", {start:%Y-%m-%d} to {end:%Y-%m-%d}"
    failed = len(fleet.failed)
    text = (
        f"{len(table)} logs of {drives} drive{'s' if drives != 1 else ''}{span}; {failed} could "
        f"not be estimated."
    )
    remarked = len({item.drive for item in followed if item.remarks})
    summary = f"{remarked} drive{'s' if remarked != 1 else ''} with remarks."
    return " ".join(
        filter(None, (text, describe_undated(table), describe_too_few(table) or summary))
    )


def remarks(followed: Sequence[Followed]) -> list[str]:
    """List all remarks, crossed limits first."""
    ordered = sorted(followed, key=lambda item: not item.crossed)
    return [f"{item.drive or 'all logs'}: {text}." for item in ordered for text in item.remarks]


def write_html(fleet: Fleet, followed: Sequence[Followed], path: Path) -> None:
    """Write the HTML report."""
    drives = sorted(
        {item.drive for item in followed},
        key=lambda drive: (not _has_remarks(followed, drive), drive),
    )
    rows = [
        [
            item.drive or "all logs",
            FOLLOWED[item.name][2],
            str(len(item.values)),
            f"{item.first:.4g}",
            f"{item.level:.4g}",
            item.unit,
            f"{item.course.scatter:.2g}",
            "; ".join(item.remarks),
        ]
        for item in sorted(followed, key=lambda item: (not item.remarks, item.drive))
    ]
    head = ("drive", "parameter", "logs", "first level", "now", "unit", "scatter", "remarks")
    failed = fleet.failed
    blocks = [
        html.paragraph(headline(fleet, followed)),
        html.bullets(remarks(followed)),
        *(
            html.picture(picture([item for item in followed if item.drive == drive], drive), drive)
            for drive in drives[:DRAWN]
        ),
        *(
            [html.paragraph(f"{len(drives) - DRAWN} more drives are only in the table.")]
            if len(drives) > DRAWN
            else []
        ),
        "<h2>All parameters</h2>",
        html.table(head, rows),
    ]
    if len(failed):
        failures = [[row["log"], row["failed"]] for row in failed.iter_rows(named=True)]
        blocks += ["<h2>Logs that failed</h2>", html.table(("log", "reason"), failures)]
    write_text(path, html.document("Fleet", *blocks))


def _has_remarks(followed: Sequence[Followed], drive: str) -> bool:
    return any(item.remarks for item in followed if item.drive == drive)


def picture(followed: Sequence[Followed], drive: str) -> Figure:
    """Plot the parameters of one drive over time, with levels and limits."""
    import matplotlib as mpl
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    with mpl.rc_context(STYLE):
        figure = new_figure(figsize=(min(3.2 * len(followed) + 0.5, 16.5), 2.3))
        axes = figure.subplots(1, len(followed), squeeze=False)[0]
    figure.suptitle(plain(drive) or "all logs", fontsize=9, x=0.01, ha="left")
    for axis, item in zip(axes, followed, strict=True):
        times = np.array([t.replace(tzinfo=None) for t in item.times], dtype="datetime64[us]")
        axis.errorbar(
            times,
            item.values,
            item.stds,
            fmt="o",
            ms=2.5,
            lw=0.7,
            color=BLUE if item.remarks else GREY,
        )
        for segment in item.course.segments:
            rows = [segment.first, segment.last - 1]
            level = item.line[rows] if segment is item.course.segments[-1] else [segment.mean] * 2
            axis.plot(times[rows], level, color=ORANGE, lw=1.5)
        if item.limits is not None:
            for bound in item.limits:
                axis.axhline(bound, color="black", lw=0.6, ls=":")
        if times[-1] - times[0] < SPAN:
            middle = times[0] + (times[-1] - times[0]) // 2
            axis.set_xlim(middle - SPAN // 2, middle + SPAN // 2)
        axis.set_title(f"{FOLLOWED[item.name][2]} [{item.unit}]")
        # With `minticks` below 2, the locator finds no interval for three days and warns.
        locator: Any = AutoDateLocator(minticks=2, maxticks=5)  # type: ignore[no-untyped-call]
        axis.xaxis.set_major_locator(locator)
        axis.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
        axis.tick_params(labelsize=7)
    return figure
