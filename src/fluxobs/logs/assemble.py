"""Assemble a log from the tables of its files; a log is one table on uniform rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import RecordError
from ..machines.model.frames import Frame, alphabeta_current
from .formats import Table, missing_column
from .log import Log, Truth, rows_between
from .meaning import units
from .meaning.guess import (
    Guess,
    NamedTable,
    base_table,
    electrical_or_mechanical,
    guess,
    name_columns,
    turn_of,
)
from .meaning.layout import Layout
from .time.align import aligned_by_content, doubt_of_time
from .time.clock import Clock
from .time.resample import Course, course_of
from .time.timed import Timed, for_columns_of, put_on_uniform_rows
from .time.uniform import JoinedTable, ResampledTable


def assemble(
    files: Sequence[tuple[Path, list[Table]]], fields: Mapping[str, Any], frames: Sequence[Frame]
) -> Log:
    """Assemble the log that these files hold.

    Raises
    ------
    RecordError
        A column is missing, the sample time is missing or contradictory, time is not uniform,
        there are too few rows, or the lag exceeds the number of rows.
    """
    named_tables = name_columns(files)
    guessed = guess(named_tables, fields, frames)
    _check_columns(named_tables, guessed)
    _classify_angle(guessed)
    layout = Layout(**guessed.fields)
    true = _truth(guessed, layout, guessed=not fields.get("truth"))
    names = dict(guessed.channels)
    wanted = [*names.values(), *(() if true is None else true.columns)]
    base = base_table(guessed.columns, names)
    needed = [
        base,
        *(
            named
            for named in named_tables
            if named is not base and any(n in named.columns for n in wanted)
        ),
    ]
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
        if any(named.table is t for named in needed)
        for note in _file_notes(path, t, len(files))
    ]
    notes += [*guessed.notes, *([layout.note] if layout.note else [])]
    timed = [put_on_uniform_rows(base, guessed, layout, courses, scales, notes)]
    for named in needed[1:]:
        timed.append(
            put_on_uniform_rows(named, guessed, layout, courses, scales, notes, base=timed[0])
        )
    plain = timed[0].table is base.table
    if len(timed) == 1:
        table, clock = timed[0].table, timed[0].clock
        names = {channel: base.columns[name] for channel, name in names.items()}
        true = _renamed(true, base)
    else:
        table, clock = _join_tables(timed, layout, courses, scales, notes)
    conversions = {channel: layout.conversion(channel) for channel in (*names, "udc")}
    if true is not None:
        conversions[true.channel] = layout.conversion(true.channel)
    if "t" in names and not plain:
        conversions["t"] = (1.0, 0.0)
    first, last = rows_between(layout, clock, table.path)
    return Log(table, layout, names, conversions, clock, first, last, tuple(notes), true)


def _file_notes(path: Path, table: Table, files: int) -> list[str]:
    return [f"{path.name}: {note}" if files > 1 else note for note in table.said.notes]


def _check_columns(named_tables: Sequence[NamedTable], guessed: Guess) -> None:
    available = list(guessed.columns.table_of)
    path = named_tables[0].table.path
    truth = guessed.fields.get("truth", {})
    several = {channel: name for channel, name in truth.items() if name not in available}
    missing = [c for c, name in guessed.channels.items() if name not in available]
    for option, wanted in (("--column", guessed.channels), ("--truth", truth)):
        for channel, name in wanted.items():
            for column in several.get(channel, name).split(",") if option == "--truth" else [name]:
                if column.strip() not in available and name not in available:
                    also = [c for c in missing if c != channel]
                    raise missing_column(path, available, column.strip(), channel, option, also)


def _classify_angle(guessed: Guess) -> None:
    """If no name says whether a true angle is electrical or mechanical, decide by its values."""
    name = guessed.fields.get("truth", {}).get("theta")
    if name is None:
        return
    named = guessed.columns.table_of[name]
    angle = named.read(name)
    unit = guessed.columns.units.get(name) or turn_of(angle) or "rad"
    channel = "theta_e"
    try:
        scale = units.factor(channel, unit)
    except RecordError:  # not an angle: a position in metres, for example
        del guessed.fields["truth"]
        return
    currents = {c: n for c, n in guessed.channels.items() if c.startswith("i_")}
    if base_table(guessed.columns, guessed.channels) is named and "theta_e" not in guessed.channels:
        vector = alphabeta_current(
            guessed.fields.get("currents") or guessed.fields["frame"],
            {c: named.read(n) for c, n in currents.items()},
        )
        channel = electrical_or_mechanical(scale * angle, vector @ np.array([1, 1j]))
    guessed.fields["truth"] = {channel: name}
    guessed.fields["unit"] = {channel: units.plain(unit)} | dict(guessed.fields.get("unit", {}))


def _truth(completed: Guess, layout: Layout, guessed: bool) -> Truth | None:
    if not layout.truth:
        return None
    ((channel, name),) = layout.truth.items()
    table_of = completed.columns.table_of
    columns = (name,) if name in table_of else tuple(column.strip() for column in name.split(","))
    wanted = {"sincos": (2,), "hall": (1, 3)}.get(channel, (1,))
    if len(columns) not in wanted:
        counts = " or ".join(map(str, wanted))
        raise RecordError(
            f"truth {channel}={name}: {counts} columns are needed, separated by commas"
        )
    if channel not in ("sincos", "hall") or len(columns) == 1:
        return Truth(channel, columns, guessed)
    values = [table_of[column].read(column) for column in columns]
    values = [np.where(np.isfinite(data), data, np.nan) for data in values]
    empty = [column for column, data in zip(columns, values, strict=True) if np.isnan(data).all()]
    if empty and guessed:
        return None
    if empty:
        raise RecordError(
            f"{table_of[empty[0]].table.path}: the column {empty[0]!r} of --truth "
            f"{channel}={name} holds no numbers"
        )
    low = np.array([np.nanmin(v) for v in values])
    high = np.array([np.nanmax(v) for v in values])
    channel = "theta_mech" if channel == "sincos" else channel
    return Truth(channel, columns, guessed, (high + low) / 2, np.maximum(high - low, 1e-300) / 2)


def _renamed(true: Truth | None, named: NamedTable) -> Truth | None:
    if true is None:
        return None
    columns = tuple(named.columns[name] for name in true.columns)
    return Truth(true.channel, columns, true.guessed, true.centre, true.size)


def _angles(true: Truth | None) -> list[tuple[str, str]]:
    if true is None or len(true.columns) > 1:
        return []
    return [(true.channel, true.columns[0])]


def _courses(names: Mapping[str, str], true: Truth | None) -> dict[str, Course]:
    courses: dict[str, Course] = {name: course_of(channel) for channel, name in names.items()}
    if true is not None:
        course = "smooth" if len(true.columns) == 2 else course_of(true.channel)
        courses |= {name: course for name in true.columns if name not in courses}
    return courses


# ---- several files -------------------------------------------------------------------------


def _join_tables(
    timed: list[Timed],
    layout: Layout,
    courses: Mapping[str, Course],
    scales: Mapping[str, float],
    notes: list[str],
) -> tuple[Table, Clock]:
    """Join all tables on the rows of the first table."""
    base = timed[0]
    tables: list[Table] = [base.table]
    for other in timed[1:]:
        if layout.align == "index" or other.clock is base.clock:
            if other.clock.rows < base.clock.rows:
                raise RecordError(
                    f"{other.named.table.path}: {other.clock.rows} rows, but "
                    f"{base.named.table.path} has {base.clock.rows}; files joined row by "
                    f"row need the same number of rows"
                )
            tables.append(other.table)
            continue
        shift, sides = (
            0.0,
            [(side.named, side.table, side.clock) for side in (base, other)],
        )
        if layout.align == "auto":
            shift, note = aligned_by_content(*sides)
            notes.append(f"{other.named.table.path.name}: {note}")
        _check_overlap(base, other, shift)
        if layout.align == "time" and (doubt := doubt_of_time(*sides)) is not None:
            notes.append(f"{other.named.table.path.name}: {doubt}")
        tables.append(
            ResampledTable(
                other.table,
                other.clock,
                base.clock,
                for_columns_of(courses, other.named),
                for_columns_of(scales, other.named),
                shift=shift,
            )
        )
    return JoinedTable(tables, [t.named.columns for t in timed]), base.clock


def _check_overlap(base: Timed, other: Timed, shift: float) -> None:
    start, end = other.clock.t0 + shift, other.clock.end + shift
    if end <= base.clock.t0 or start >= base.clock.end:
        raise RecordError(
            f"{other.named.table.path}: the file runs from {start:.6g} s to {end:.6g} s, but "
            f"{base.named.table.path} runs from {base.clock.t0:.6g} s to {base.clock.end:.6g} s. "
            f"If the clocks of the files differ, --align auto finds the shift; --align index "
            f"joins the files row by row"
        )
