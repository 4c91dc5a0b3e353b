"""A part of a log on uniform rows: its time column found, its stamps judged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ..core.arrays import Array
from ..errors import RecordError
from . import units
from .clock import Clock, even, measure
from .formats import Table
from .guess import Guess, NamedTable
from .layout import NO_COLUMN, Layout
from .names import read_name
from .resample import Course
from .uniform import FilledTable, ResampledTable

#: A sample time in a header is believed if the stamps agree within this share of it.
AGREES = 5e-3
#: Stamps that jitter are believed if with them currents are smoother by this factor than without.
SMOOTHER = 0.9


Value = TypeVar("Value")


@dataclass(frozen=True, eq=False)
class Timed:
    """A part on uniform rows.

    Attributes
    ----------
    part : NamedTable
    table : Table
        Its columns, uniform.
    clock : Clock
    time : str, optional
        Column of the time, if there is one.
    """

    part: NamedTable
    table: Table
    clock: Clock
    time: str | None


def timed_part(
    part: NamedTable,
    found: Guess,
    layout: Layout,
    courses: Mapping[str, Course],
    scales: Mapping[str, float],
    notes: list[str],
    beside: Timed | None = None,
) -> Timed:
    """Find the times of a part, and put it on uniform rows."""
    table, said = part.table, part.table.said
    name = _time_of(part, found, layout, beside is not None)
    where = "" if beside is None else f"{table.path.name}: "
    if name is None:
        given = layout.sample_time or said.sample_time
        if given is None and beside is not None and table.rows == beside.part.table.rows:
            return Timed(part, table, beside.clock, None)
        if given is None and beside is not None:
            raise RecordError(
                f"{table.path}: {', '.join(list(part.columns)[:4])} have {table.rows} rows and no "
                f"times, where {beside.part.table.path} has {beside.part.table.rows} rows. Give "
                f"columns of one length, or each its times"
            )
        if given is None:
            raise RecordError(
                f"{table.path}: no sample time: there is no column t. Give --sample-time, or "
                f"--column t=COLUMN"
            )
        if layout.sample_time is None:
            notes.append(f"{where}the sample time, {given:g} s, is that of the file's header")
        return Timed(part, table, even(table.rows, given, said.start), None)
    scale, offset = _time_conversion(name, found, layout)
    column = part.columns[name]
    if table.rows < 3:
        if beside is not None:
            raise RecordError(
                f"{table.path}: {table.rows} rows; a file that is joined by its times needs at "
                f"least three"
            )
        return Timed(part, table, even(table.rows, 1.0), name)
    given = layout.sample_time
    clock, typical, mean = measure(table, column, scale, offset, given)
    if given is None and said.sample_time is not None:
        off = min(abs(typical / said.sample_time - 1), abs(mean / said.sample_time - 1))
        if off < AGREES and clock.rounding > 0:
            clock, _, _ = measure(table, column, scale, offset, said.sample_time)
    notes += [where + note for note in _time_notes(clock)]
    if clock.jitter and not _rounded(clock):
        if _stamps_are_true(part, found, column, scale, offset, clock):
            notes.append(
                f"{where}t jitters by {clock.jitter / clock.sample_time:.0%} of the sample time "
                f"(rms); all channels are brought to uniform times, voltages as held between their "
                f"stamps. Errors of the stamps themselves, of that size, would turn the angle by "
                f"{np.degrees(600 * clock.jitter):.2g}° at 600 rad/s"
            )
            known = (own(courses, part), own(scales, part))
            moved = ResampledTable(table, clock, clock, *known, (column, scale, offset))
            return Timed(part, moved, clock, name)
        notes.append(
            f"{where}t jitters by {clock.jitter / clock.sample_time:.0%} of the sample time (rms), "
            f"but the currents are smoother without: only the stamps jitter, and the samples are "
            f"taken as uniform"
        )
    if clock.plain:
        return Timed(part, table, clock, name)
    return Timed(part, FilledTable(table, clock, column), clock, name)


def own(of: Mapping[str, Value], part: NamedTable) -> dict[str, Value]:
    """What is known of columns, by their names in the table of a part."""
    return {part.columns[name]: value for name, value in of.items() if name in part.columns}


def _time_of(part: NamedTable, found: Guess, layout: Layout, other: bool) -> str | None:
    if not other:
        return found.channels.get("t")
    if layout.align == "index" or layout.columns.get("t") == NO_COLUMN:
        return None
    names = [*found.columns.by_channel.get("t", []), *_times_in(part)]
    return next((name for name in names if name in part.columns), None)


def _times_in(part: NamedTable) -> list[str]:
    return [name for name in part.columns if read_name(name).channel == "t"]


def _time_conversion(name: str, found: Guess, layout: Layout) -> tuple[float, float]:
    """Scale and offset of a time column: the user's, or by its own unit."""
    if name == found.channels.get("t") or "t" not in layout.unit:
        scale, offset = layout.conversion("t")
        if name == found.channels.get("t") or "t" in layout.scale:
            return scale, offset
    unit = found.columns.units.get(name)
    return (units.factor("t", unit) if unit else 1.0), layout.offset.get("t", 0.0)


def _rounded(clock: Clock) -> bool:
    return clock.rounding > 0 and clock.jitter <= clock.rounding


def _time_notes(clock: Clock) -> list[str]:
    out = []
    gaps = len(clock.at) - 1
    if gaps:
        size = np.diff(clock.t) - np.diff(clock.source) * clock.sample_time
        longest = int(np.argmax(size))
        out.append(
            f"t has {gaps} gap{'s' if gaps > 1 else ''}, in which {clock.missing} samples are "
            f"missing; the longest is {size[longest]:.3g} s before t = {clock.t[longest + 1]:.6g} s"
        )
    if clock.wrap:
        out.append(f"t starts again every {clock.wrap:.6g} s, and is continued there")
    if clock.rounding:
        out.append(
            f"t is rounded to {clock.rounding:g} s; the samples are taken as uniform, "
            f"{clock.sample_time:g} s apart"
        )
    return out


def _stamps_are_true(
    part: NamedTable, found: Guess, column: str, scale: float, offset: float, clock: Clock
) -> bool:
    """Whether samples were taken at their jittering stamps: currents are smoother then."""
    names = [n for c, n in found.channels.items() if c.startswith("i_") and n in part.columns]
    if not names:
        return True
    name = next(n for n, c in part.columns.items() if c == column)
    rows = min(20_000, int(clock.source[1]) if len(clock.source) > 1 else part.table.rows)
    t = np.asarray(part.read(name, rows=rows) * scale + offset)
    currents = [part.read(n, rows=rows) for n in names]
    even = np.arange(len(t), dtype=float)
    stamped = sum(_roughness(t, current) for current in currents)
    return stamped < SMOOTHER * sum(_roughness(even, current) for current in currents)


def _roughness(t: Array, values: Array) -> float:
    """Median error of a sample predicted from two on either side, by their cubic."""
    if len(t) < 8 or (np.diff(t) <= 0).any():
        return 0.0
    x = np.stack([t[k : len(t) - 4 + k] for k in (0, 1, 3, 4)]) - t[2:-2]
    y = np.stack([values[k : len(t) - 4 + k] for k in (0, 1, 3, 4)])
    predicted = np.zeros(x.shape[1])
    for k in range(4):
        others = [j for j in range(4) if j != k]
        predicted += y[k] * np.prod([x[j] / (x[j] - x[k]) for j in others], axis=0)
    return float(np.nanmedian(np.abs(predicted - values[2:-2])))
