"""Put the tables of a log on uniform rows: find the time column and examine its stamps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ...core.arrays import Array
from ...errors import RecordError
from ..formats import Table
from ..meaning import units
from ..meaning.guess import Guess, NamedTable
from ..meaning.layout import NO_COLUMN, Layout
from ..meaning.names import read_name
from .clock import Clock, even, measure
from .resample import Course
from .uniform import FilledTable, ResampledTable

#: A sample time in a header is used if it differs from the steps of t by less than this share.
AGREES = 5e-3
#: Jittering stamps are used if they make the currents smoother by this factor.
SMOOTHER = 0.9


Value = TypeVar("Value")


@dataclass(frozen=True, eq=False)
class Timed:
    """Table of a log on uniform rows.

    Attributes
    ----------
    named : NamedTable
        The table as it is in the file.
    table : Table
        The table on uniform rows.
    clock : Clock
    time : str, optional
        Time column, if there is one.
    """

    named: NamedTable
    table: Table
    clock: Clock
    time: str | None


def put_on_uniform_rows(
    named: NamedTable,
    guessed: Guess,
    layout: Layout,
    courses: Mapping[str, Course],
    scales: Mapping[str, float],
    notes: list[str],
    base: Timed | None = None,
) -> Timed:
    """Put a table on uniform rows by its times; if files are joined, `base` is the first table."""
    table, metadata = named.table, named.table.said
    name = _time_column(named, guessed, layout, base is not None)
    prefix = "" if base is None else f"{table.path.name}: "
    if name is None:
        given = layout.sample_time or metadata.sample_time
        if given is None and base is not None and table.rows == base.named.table.rows:
            return Timed(named, table, base.clock, None)
        if given is None and base is not None:
            raise RecordError(
                f"{table.path}: {', '.join(list(named.columns)[:4])} have {table.rows} rows and no "
                f"times, but {base.named.table.path} has {base.named.table.rows} rows. Give "
                f"columns of equal length, or times for each file"
            )
        if given is None:
            raise RecordError(
                f"{table.path}: no sample time, and no column t. Give --sample-time or --column "
                f"t=COLUMN"
            )
        if layout.sample_time is None:
            notes.append(f"{prefix}the sample time, {given:g} s, is taken from the file's header")
        return Timed(named, table, even(table.rows, given, metadata.start), None)
    scale, offset = _time_conversion(name, guessed, layout)
    column = named.columns[name]
    if table.rows < 3:
        if base is not None:
            raise RecordError(
                f"{table.path}: {table.rows} rows; a file that is joined by its times needs at "
                f"least three rows"
            )
        return Timed(named, table, even(table.rows, 1.0), name)
    given = layout.sample_time
    clock, typical, mean = measure(table, column, scale, offset, given)
    if given is None and metadata.sample_time is not None:
        deviation = min(
            abs(typical / metadata.sample_time - 1), abs(mean / metadata.sample_time - 1)
        )
        if deviation < AGREES and clock.rounding > 0:
            clock, _, _ = measure(table, column, scale, offset, metadata.sample_time)
    notes += [prefix + note for note in _time_notes(clock)]
    if clock.jitter and not _rounded(clock):
        if _stamps_are_true(named, guessed, column, scale, offset, clock):
            notes.append(
                f"{prefix}t jitters by {clock.jitter / clock.sample_time:.0%} of the sample time "
                f"(rms); all channels are resampled to uniform times; voltages count as held "
                f"between stamps. If the stamps are wrong by this jitter, the angle is off by "
                f"{np.degrees(600 * clock.jitter):.2g}° at 600 rad/s"
            )
            conversions = (for_columns_of(courses, named), for_columns_of(scales, named))
            resampled = ResampledTable(table, clock, clock, *conversions, (column, scale, offset))
            return Timed(named, resampled, clock, name)
        notes.append(
            f"{prefix}t jitters by {clock.jitter / clock.sample_time:.0%} of the sample time "
            f"(rms), but the currents are smoother without this jitter: only the stamps jitter, "
            f"and the samples are taken as uniform"
        )
    if clock.plain:
        return Timed(named, table, clock, name)
    return Timed(named, FilledTable(table, clock, column), clock, name)


def for_columns_of(by_name: Mapping[str, Value], named: NamedTable) -> dict[str, Value]:
    """Return the entries for columns of a table; the keys are the columns' names in the table."""
    return {named.columns[name]: value for name, value in by_name.items() if name in named.columns}


def _time_column(named: NamedTable, guessed: Guess, layout: Layout, is_joined: bool) -> str | None:
    if not is_joined:
        return guessed.channels.get("t")
    if layout.align == "index" or layout.columns.get("t") == NO_COLUMN:
        return None
    names = [*guessed.columns.by_channel.get("t", []), *_time_columns(named)]
    return next((name for name in names if name in named.columns), None)


def _time_columns(named: NamedTable) -> list[str]:
    return [name for name in named.columns if read_name(name).channel == "t"]


def _time_conversion(name: str, guessed: Guess, layout: Layout) -> tuple[float, float]:
    """Return (scale, offset) of a time column, from the user or from the column's unit."""
    if name == guessed.channels.get("t") or "t" not in layout.unit:
        scale, offset = layout.conversion("t")
        if name == guessed.channels.get("t") or "t" in layout.scale:
            return scale, offset
    unit = guessed.columns.units.get(name)
    return (units.factor("t", unit) if unit else 1.0), layout.offset.get("t", 0.0)


def _rounded(clock: Clock) -> bool:
    return clock.rounding > 0 and clock.jitter <= clock.rounding


def _time_notes(clock: Clock) -> list[str]:
    notes = []
    gaps = len(clock.at) - 1
    if gaps:
        size = np.diff(clock.t) - np.diff(clock.source) * clock.sample_time
        longest = int(np.argmax(size))
        notes.append(
            f"t has {gaps} gap{'s' if gaps > 1 else ''}, in which {clock.missing} samples are "
            f"missing; the longest is {size[longest]:.3g} s before t = {clock.t[longest + 1]:.6g} s"
        )
    if clock.wrap:
        notes.append(f"t wraps every {clock.wrap:.6g} s; the wraps are removed")
    if clock.rounding:
        notes.append(
            f"t is rounded to {clock.rounding:g} s; the samples are taken as uniform, "
            f"{clock.sample_time:g} s apart"
        )
    return notes


def _stamps_are_true(
    named: NamedTable, guessed: Guess, column: str, scale: float, offset: float, clock: Clock
) -> bool:
    """Return whether samples were taken at the jittering stamps: the currents are then smoother."""
    names = [n for c, n in guessed.channels.items() if c.startswith("i_") and n in named.columns]
    if not names:
        return True
    name = next(n for n, c in named.columns.items() if c == column)
    rows = min(20_000, int(clock.source[1]) if len(clock.source) > 1 else named.table.rows)
    t = np.asarray(named.read(name, rows=rows) * scale + offset)
    currents = [named.read(n, rows=rows) for n in names]
    even = np.arange(len(t), dtype=float)
    stamped = sum(_roughness(t, current) for current in currents)
    return stamped < SMOOTHER * sum(_roughness(even, current) for current in currents)


def _roughness(t: Array, values: Array) -> float:
    """Predict each sample by the cubic through two on each side; return the median error."""
    if len(t) < 8 or (np.diff(t) <= 0).any():
        return 0.0
    x = np.stack([t[k : len(t) - 4 + k] for k in (0, 1, 3, 4)]) - t[2:-2]
    y = np.stack([values[k : len(t) - 4 + k] for k in (0, 1, 3, 4)])
    predicted = np.zeros(x.shape[1])
    for k in range(4):
        others = [j for j in range(4) if j != k]
        predicted += y[k] * np.prod([x[j] / (x[j] - x[k]) for j in others], axis=0)
    return float(np.nanmedian(np.abs(predicted - values[2:-2])))
