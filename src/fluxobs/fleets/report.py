"""The report of a fleet: what changed, for a terminal and as HTML with pictures."""

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
from .follow import FOLLOWED, Followed, enough, timeless

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Least time that a picture shows.
SPAN = np.timedelta64(1, "D").astype("timedelta64[us]")
#: Drives that are drawn: those with remarks first.
DRAWN = 40


def headline(fleet: Fleet, found: Sequence[Followed]) -> str:
    """The fleet in a sentence or two."""
    table = fleet.table
    drives = table["drive"].n_unique()
    times = table["time"].drop_nulls()
    first, last = times.min(), times.max()
    span = ""
    if isinstance(first, datetime) and isinstance(last, datetime):
        span = f", {first:%Y-%m-%d} to {last:%Y-%m-%d}"
    failed = len(fleet.failed)
    text = (
        f"{len(table)} logs of {drives} drive{'s' if drives != 1 else ''}{span}; {failed} could "
        f"not be estimated."
    )
    marked = len({one.drive for one in found if one.remarks})
    words = f"{marked} drive{'s' if marked != 1 else ''} with remarks."
    return " ".join(filter(None, (text, timeless(table), enough(table) or words)))


def remarks(found: Sequence[Followed]) -> list[str]:
    """Everything that is to be said, crossed limits first."""
    ordered = sorted(found, key=lambda one: not one.crossed)
    return [f"{one.drive or 'all logs'}: {text}." for one in ordered for text in one.remarks]


def write_html(fleet: Fleet, found: Sequence[Followed], path: Path) -> None:
    """Write the report."""
    drives = sorted(
        {one.drive for one in found}, key=lambda drive: (not _marked(found, drive), drive)
    )
    rows = [
        [
            one.drive or "all logs",
            FOLLOWED[one.name][2],
            str(len(one.values)),
            f"{one.first:.4g}",
            f"{one.level:.4g}",
            one.unit,
            f"{one.course.scatter:.2g}",
            "; ".join(one.remarks),
        ]
        for one in sorted(found, key=lambda one: (not one.remarks, one.drive))
    ]
    head = ("drive", "parameter", "logs", "first level", "now", "unit", "scatter", "remarks")
    failed = fleet.failed
    parts = [
        html.paragraph(headline(fleet, found)),
        html.bullets(remarks(found)),
        *(
            html.picture(picture([one for one in found if one.drive == drive], drive), drive)
            for drive in drives[:DRAWN]
        ),
        *(
            [html.paragraph(f"{len(drives) - DRAWN} more drives are in the table.")]
            if len(drives) > DRAWN
            else []
        ),
        "<h2>All parameters</h2>",
        html.table(head, rows),
    ]
    if len(failed):
        words = [[row["log"], row["failed"]] for row in failed.iter_rows(named=True)]
        parts += ["<h2>Logs that failed</h2>", html.table(("log", "why"), words)]
    write_text(path, html.document("Fleet", *parts))


def _marked(found: Sequence[Followed], drive: str) -> bool:
    return any(one.remarks for one in found if one.drive == drive)


def picture(found: Sequence[Followed], drive: str) -> Figure:
    """The parameters of one drive over time, with levels and limits."""
    import matplotlib as mpl
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    with mpl.rc_context(STYLE):
        figure = new_figure(figsize=(min(3.2 * len(found) + 0.5, 16.5), 2.3))
        axes = figure.subplots(1, len(found), squeeze=False)[0]
    figure.suptitle(plain(drive) or "all logs", fontsize=9, x=0.01, ha="left")
    for axis, one in zip(axes, found, strict=True):
        when = np.array([t.replace(tzinfo=None) for t in one.times], dtype="datetime64[us]")
        axis.errorbar(
            when, one.values, one.stds, fmt="o", ms=2.5, lw=0.7, color=BLUE if one.remarks else GREY
        )
        for segment in one.course.segments:
            rows = [segment.first, segment.last - 1]
            drawn = one.line[rows] if segment is one.course.segments[-1] else [segment.mean] * 2
            axis.plot(when[rows], drawn, color=ORANGE, lw=1.5)
        if one.limits is not None:
            for bound in one.limits:
                axis.axhline(bound, color="black", lw=0.6, ls=":")
        if when[-1] - when[0] < SPAN:
            middle = when[0] + (when[-1] - when[0]) // 2
            axis.set_xlim(middle - SPAN // 2, middle + SPAN // 2)
        axis.set_title(f"{FOLLOWED[one.name][2]} [{one.unit}]")
        # With two ticks at least, there is an interval for every length; else three days warn.
        locator: Any = AutoDateLocator(minticks=2, maxticks=5)  # type: ignore[no-untyped-call]
        axis.xaxis.set_major_locator(locator)
        axis.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
        axis.tick_params(labelsize=7)
    return figure
