"""From the tables of files and what is known of them to a log: one table on uniform rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import RecordError
from ..machines.model.frames import Frame, alphabeta_current
from . import units
from .align import aligned_by_content, doubt_of_time
from .clock import Clock
from .formats import Table, missing_column
from .guess import Guess, NamedTable, base_part, electrical_or_mechanical, guess, parts_of, turn_of
from .layout import Layout
from .log import Log, Truth, rows_between
from .resample import Course, course_of
from .timed import Timed, own, timed_part
from .uniform import JoinedTable, ResampledTable


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
    timed = [timed_part(base, found, layout, courses, scales, notes)]
    for part in needed[1:]:
        timed.append(timed_part(part, found, layout, courses, scales, notes, beside=timed[0]))
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


def _check_columns(parts: Sequence[NamedTable], found: Guess) -> None:
    available = list(found.columns.part_of)
    path = parts[0].table.path
    truth = found.fields.get("truth", {})
    several = {channel: name for channel, name in truth.items() if name not in available}
    missing = [c for c, name in found.channels.items() if name not in available]
    for option, wanted in (("--column", found.channels), ("--truth", truth)):
        for channel, name in wanted.items():
            for one in several.get(channel, name).split(",") if option == "--truth" else [name]:
                if one.strip() not in available and name not in available:
                    also = [c for c in missing if c != channel]
                    raise missing_column(path, available, one.strip(), channel, option, also)


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
    values = [np.where(np.isfinite(read), read, np.nan) for read in values]
    empty = [one for one, read in zip(columns, values, strict=True) if np.isnan(read).all()]
    if empty and guessed:
        return None
    if empty:
        raise RecordError(
            f"{part_of[empty[0]].table.path}: the column {empty[0]!r}, which --truth "
            f"{channel}={name} asks for, holds no number"
        )
    low = np.array([np.nanmin(v) for v in values])
    high = np.array([np.nanmax(v) for v in values])
    channel = "theta_mech" if channel == "sincos" else channel
    return Truth(channel, columns, guessed, (high + low) / 2, np.maximum(high - low, 1e-300) / 2)


def _renamed(true: Truth | None, part: NamedTable) -> Truth | None:
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
        shift, sides = 0.0, [(one.part, one.table, one.clock) for one in (base, other)]
        if layout.align == "auto":
            shift, words = aligned_by_content(*sides)
            notes.append(f"{other.part.table.path.name}: {words}")
        _check_overlap(base, other, shift)
        if layout.align == "time" and (doubt := doubt_of_time(*sides)) is not None:
            notes.append(f"{other.part.table.path.name}: {doubt}")
        tables.append(
            ResampledTable(
                other.table,
                other.clock,
                base.clock,
                own(courses, other.part),
                own(scales, other.part),
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
