"""Tables of a benchmark: text, CSV, Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import polars as pl

from ..core.output import make_folder, write_text
from ..errors import FluxobsError
from .entrants import Entrant
from .scores import Score, Summary, table_of
from .suite import Suite

#: Columns of the tables: title, attribute of a summary, format, factor.
COLUMNS = (
    ("records", "records", "d", 1),
    ("rms °", "rms", ".2f", 1),
    ("valid %", "valid", ".1f", 100),
    ("rms of valid °", "rms_valid", ".2f", 1),
    ("worst valid °", "worst_valid", ".1f", 1),
    ("in 1σ %", "within_1", ".1f", 100),
    ("in 2σ %", "within_2", ".1f", 100),
    ("in 3σ %", "within_3", ".1f", 100),
    ("interval °", "interval", ".1f", 1),
    ("first valid s", "first_valid", ".2f", 1),
    ("lost", "lost_drives", "d", 1),
    ("sure and wrong", "sure_and_wrong", "d", 1),
    ("speed rad/s", "speed", ".2f", 1),
    ("torque N m", "torque", ".3f", 1),
    ("µs", "microseconds", ".1f", 1),
)


def cells(summary: Summary) -> list[str]:
    """Return the cells of a row."""
    row = []
    for _, name, form, factor in COLUMNS:
        value = getattr(summary, name)
        row.append("" if value is None or value != value else format(factor * value, form))
    return row


#: File with the summaries.
SUMMARY = "summary.csv"
#: Columns that a terminal shows.
SHORT = (
    "rms °",
    "valid %",
    "rms of valid °",
    "worst valid °",
    "in 2σ %",
    "interval °",
    "lost",
    "µs",
)


def text_table(summaries: Sequence[Summary]) -> str:
    """Return aligned text, a row per summary, with the columns of SHORT."""
    shown = [n for n, (title, *_) in enumerate(COLUMNS) if title in SHORT]
    rows = [["entrant", "track", "records of", *(COLUMNS[n][0] for n in shown)]]
    for s in summaries:
        row = cells(s)
        rows.append([s.entrant, s.track, s.group, *(row[n] for n in shown)])
    widths = [max(len(row[n]) for row in rows) for n in range(len(rows[0]))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if n < 3 else cell.rjust(width)
            for n, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    )


def markdown_table(summaries: Sequence[Summary]) -> str:
    """Return a Markdown table, a row per summary."""
    titles = ["entrant", "track", *(title for title, *_ in COLUMNS)]
    lines = [titles, ["---"] * len(titles)]
    lines += [[s.entrant, s.track, *cells(s)] for s in summaries]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def write_report(
    folder: Path,
    suite: Suite,
    results: Sequence[tuple[Entrant, list[Score], list[Summary]]],
) -> None:
    """Write scores.csv (a row per record), summary.csv and summary.md.

    Raises
    ------
    FluxobsError
        The folder cannot be written, or there are no scores.
    """
    make_folder(folder)
    tables = [table_of(scores, entrant) for entrant, scores, _ in results if scores]
    if not tables:
        raise FluxobsError("no entrant has an observer for a machine of the suite")
    pl.concat(tables, how="vertical_relaxed").write_csv(folder / "scores.csv")
    summaries = [summary for _, _, found in results for summary in found]
    frame = pl.DataFrame([asdict(summary) for summary in summaries], infer_schema_length=None)
    frame.write_csv(folder / SUMMARY)
    heading = f"{suite.title}\n\n"
    parts = []
    for group in dict.fromkeys(summary.group for summary in summaries):
        members = [summary for summary in summaries if summary.group == group]
        parts.append(f"**{group}**\n\n{markdown_table(members)}\n")
    write_text(folder / "summary.md", heading + "".join(parts))
