"""From the tables of files and what is known of them to a log: one table on uniform rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ..errors import RecordError
from ..model.frames import Frame, alphabeta_current
from . import units
from .align import aligned_by_content
from .clock import Clock, even, measure
from .formats import Table, missing_column
from .guess import Guess, Part, base_part, electrical_or_mechanical, guess, parts_of, turn_of
from .layout import NO_COLUMN, Layout
from .log import Log, Truth, rows_between
from .names import read_name
from .resample import Array, Course, course_of
from .uniform import FilledTable, JoinedTable, ResampledTable

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
    part : Part
    table : Table
        Its columns, uniform.
    clock : Clock
    time : str, optional
        Column of the time, if there is one.
    """

    part: Part
    table: Table
    clock: Clock
    time: str | None


def assemble(
    files: Sequence[tuple[Path, list[Table]]], fields: Mapping[str, Any], frames: Sequence[Frame]
) -> Log:
    """Open the log that these files hold.

    Raises
    ------
    RecordError
        A column is missing, there is no sample time or two that disagree, time is not uniform,
        there are too few rows, or the lag lies outside of them.
    """
    parts = parts_of(files)
    found = guess(parts, fields, frames)
    _check_columns(parts, found)
    _decide_angle(found)
    layout = Layout(**found.fields)
    true = _truth(found, layout, guessed=not fields.get("truth"))
    names = dict(found.channels)
    wanted = [*names.values(), *(() if true is None else true.columns)]
    base = base_part(found.columns, names)
    needed = [base, *(p for p in parts if p is not base and any(n in p.columns for n in wanted))]
    courses = _courses(names, true)
    scales = {
        name: layout.conversion(channel)[0]
        for channel, name in [*names.items(), *_angles(true)]
        if courses.get(name) == "angle"
    }
    notes = [
        note
        for path, tables in files
        for t in tables
        if any(p.table is t for p in needed)
        for note in _of_file(path, t, len(files))
    ]
    notes += [*found.notes, *([layout.note] if layout.note else [])]
    timed = [_timed(base, found, layout, courses, scales, notes)]
    for part in needed[1:]:
        timed.append(_timed(part, found, layout, courses, scales, notes, beside=timed[0]))
    plain = timed[0].table is base.table
    if len(timed) == 1:
        table, clock = timed[0].table, timed[0].clock
        names = {channel: base.columns[name] for channel, name in names.items()}
        true = _renamed(true, base)
    else:
        table, clock = _joined(timed, layout, courses, scales, notes)
    conversions = {channel: layout.conversion(channel) for channel in (*names, "udc")}
    if true is not None:
        conversions[true.channel] = layout.conversion(true.channel)
    if "t" in names and not plain:
        conversions["t"] = (1.0, 0.0)
    first, last = rows_between(layout, clock, table.path)
    return Log(table, layout, names, conversions, clock, first, last, tuple(notes), true)


def _of_file(path: Path, table: Table, files: int) -> list[str]:
    return [f"{path.name}: {note}" if files > 1 else note for note in table.said.notes]


def _check_columns(parts: Sequence[Part], found: Guess) -> None:
    available = list(found.columns.part_of)
    path = parts[0].table.path
    truth = found.fields.get("truth", {})
    several = {channel: name for channel, name in truth.items() if name not in available}
    for option, wanted in (("--column", found.channels), ("--truth", truth)):
        for channel, name in wanted.items():
            for one in several.get(channel, name).split(",") if option == "--truth" else [name]:
                if one.strip() not in available and name not in available:
                    raise missing_column(path, available, one.strip(), channel, option)


def _decide_angle(found: Guess) -> None:
    """Whether a true angle is electrical or mechanical, where its name does not say it."""
    name = found.fields.get("truth", {}).get("theta")
    if name is None:
        return
    part = found.columns.part_of[name]
    angle = part.read(name)
    unit = found.columns.units.get(name) or turn_of(angle) or "rad"
    channel = "theta_e"
    try:
        scale = units.factor(channel, unit)
    except RecordError:  # a position in metres, for example
        del found.fields["truth"]
        return
    currents = {c: n for c, n in found.channels.items() if c.startswith("i_")}
    if base_part(found.columns, found.channels) is part and "theta_e" not in found.channels:
        vector = alphabeta_current(
            found.fields.get("currents") or found.fields["frame"],
            {c: part.read(n) for c, n in currents.items()},
        )
        channel = electrical_or_mechanical(scale * angle, vector @ np.array([1, 1j]))
    found.fields["truth"] = {channel: name}
    found.fields["unit"] = {channel: units.plain(unit)} | dict(found.fields.get("unit", {}))


def _truth(found: Guess, layout: Layout, guessed: bool) -> Truth | None:
    if not layout.truth:
        return None
    ((channel, name),) = layout.truth.items()
    part_of = found.columns.part_of
    columns = (name,) if name in part_of else tuple(one.strip() for one in name.split(","))
    wanted = {"sincos": (2,), "hall": (1, 3)}.get(channel, (1,))
    if len(columns) not in wanted:
        words = " or ".join(map(str, wanted))
        raise RecordError(f"truth {channel}={name}: {words} columns are needed, parted by commas")
    if channel not in ("sincos", "hall") or len(columns) == 1:
        return Truth(channel, columns, guessed)
    values = [part_of[one].read(one) for one in columns]
    low = np.array([np.nanmin(v) for v in values])
    high = np.array([np.nanmax(v) for v in values])
    channel = "theta_mech" if channel == "sincos" else channel
    return Truth(channel, columns, guessed, (high + low) / 2, np.maximum(high - low, 1e-300) / 2)


def _renamed(true: Truth | None, part: Part) -> Truth | None:
    if true is None:
        return None
    columns = tuple(part.columns[name] for name in true.columns)
    return Truth(true.channel, columns, true.guessed, true.centre, true.size)


def _angles(true: Truth | None) -> list[tuple[str, str]]:
    if true is None or len(true.columns) > 1:
        return []
    return [(true.channel, true.columns[0])]


def _courses(names: Mapping[str, str], true: Truth | None) -> dict[str, Course]:
    out: dict[str, Course] = {name: course_of(channel) for channel, name in names.items()}
    if true is not None:
        course = "smooth" if len(true.columns) == 2 else course_of(true.channel)
        out |= {name: course for name in true.columns if name not in out}
    return out


# ---- time ----------------------------------------------------------------------------------


def _timed(
    part: Part,
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
                f"(rms); the samples are brought to uniform times, voltages as held between their "
                f"stamps. What remains of the jitter turns the angle by speed times its size: "
                f"{np.degrees(600 * clock.jitter):.2g}° rms at 600 rad/s if stamps were as wrong"
            )
            own = (_own(courses, part), _own(scales, part))
            moved = ResampledTable(table, clock, clock, *own, (column, scale, offset))
            return Timed(part, moved, clock, name)
        notes.append(
            f"{where}t jitters by {clock.jitter / clock.sample_time:.0%} of the sample time (rms), "
            f"but the currents are smoother without: only the stamps jitter, and the samples are "
            f"taken as uniform"
        )
    if clock.plain:
        return Timed(part, table, clock, name)
    return Timed(part, FilledTable(table, clock, column), clock, name)


def _own(of: Mapping[str, Value], part: Part) -> dict[str, Value]:
    """What is known of columns, by their names in the table of a part."""
    return {part.columns[name]: value for name, value in of.items() if name in part.columns}


def _time_of(part: Part, found: Guess, layout: Layout, other: bool) -> str | None:
    if not other:
        return found.channels.get("t")
    if layout.align == "index" or layout.columns.get("t") == NO_COLUMN:
        return None
    names = [*found.columns.by_channel.get("t", []), *_times_in(part)]
    return next((name for name in names if name in part.columns), None)


def _times_in(part: Part) -> list[str]:
    return [name for name in part.columns if read_name(name).channel == "t"]


def _time_conversion(name: str, found: Guess, layout: Layout) -> tuple[float, float]:
    """Scale and offset of a time column: the user's, or by its own unit."""
    if name == found.channels.get("t") or layout.of_channel("unit", "t") is None:
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
    part: Part, found: Guess, column: str, scale: float, offset: float, clock: Clock
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


# ---- several files -------------------------------------------------------------------------


def _joined(
    timed: list[Timed],
    layout: Layout,
    courses: Mapping[str, Course],
    scales: Mapping[str, float],
    notes: list[str],
) -> tuple[Table, Clock]:
    """All parts on the rows of the first."""
    base = timed[0]
    tables: list[Table] = [base.table]
    for other in timed[1:]:
        if layout.align == "index" or other.clock is base.clock:
            if other.clock.rows < base.clock.rows:
                raise RecordError(
                    f"{other.part.table.path}: {other.clock.rows} rows, where "
                    f"{base.part.table.path} has {base.clock.rows}; files that are joined row by "
                    f"row need as many"
                )
            tables.append(other.table)
            continue
        shift = 0.0
        if layout.align == "auto":
            shift, words = aligned_by_content(
                (base.part, base.table, base.clock), (other.part, other.table, other.clock)
            )
            notes.append(f"{other.part.table.path.name}: {words}")
        _check_overlap(base, other, shift)
        tables.append(
            ResampledTable(
                other.table,
                other.clock,
                base.clock,
                _own(courses, other.part),
                _own(scales, other.part),
                shift=shift,
            )
        )
    return JoinedTable(tables, [t.part.columns for t in timed]), base.clock


def _check_overlap(base: Timed, other: Timed, shift: float) -> None:
    start, end = other.clock.t0 + shift, other.clock.end + shift
    if end <= base.clock.t0 or start >= base.clock.end:
        raise RecordError(
            f"{other.part.table.path}: runs from {start:.6g} s to {end:.6g} s, but "
            f"{base.part.table.path} from {base.clock.t0:.6g} s to {base.clock.end:.6g} s. If "
            f"their clocks differ, --align auto finds by how much, --align index joins row by row"
        )
