"""Guess which channels the columns of a log hold, if the user does not name the columns.

Names and units decide. If they do not suffice, the values of columns with known units decide.
`notes` states every guess, so that the user can check it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.arrays import Array
from ...errors import RecordError
from ...machines.model.frames import CURRENTS, PHASE_CURRENTS, VOLTAGES, Frame
from ..formats import Table, read_rows
from . import units
from .layout import CONVERTING, NO_COLUMN, NO_TRUTH, keys_for
from .names import Named, is_setpoint, leaf, read_name
from .presets import refusal_of

#: Number of rows examined.
ROWS = 20_000
#: Frames in which rotating machines are logged, in order of preference.
ROTATING: tuple[Frame, ...] = ("alphabeta", "abc", "line", "duty", "dq")
#: Range of plausible time steps [s]. It spans a factor of 1000, so that only one unit fits.
STEPS = (2e-5, 2e-2)
#: Cosines of the angles between two signals, and the tolerance for noise and offsets.
BETWEEN = {"phases": -0.5, "axes": 0.0}
NEAR = 0.2
#: If a duty is below minus this value, duties range from −1 to 1.
NEGATIVE = 0.02
#: Value at which an angle wraps, a full turn → unit of the angle.
TURNS = {
    360.0: "deg",
    1.0: "turn",
    65536.0: "counts:65536",
    32768.0: "counts:32768",
    16384.0: "counts:16384",
    8192.0: "counts:8192",
    4096.0: "counts:4096",
}
#: A duty above DUTY_MOST is not a share of the DC link; up to PERCENT, it may be in percent.
DUTY_MOST, PERCENT = 1.5, 100.0


@dataclass(frozen=True)
class NamedTable:
    """Table of a log, and the names that the table's columns have in the log."""

    table: Table
    columns: dict[str, str]  # name in the log → column of the table

    def read(self, name: str, first: int = 0, rows: int = ROWS) -> Array:
        """Read rows of a column."""
        last = min(first + rows, self.table.rows)
        return read_rows(self.table, [self.columns[name]], first, last)[self.columns[name]]


def name_columns(files: Sequence[tuple[Path, list[Table]]]) -> list[NamedTable]:
    """Name the columns of all tables: keep a name, or use "file/column" if the name repeats."""
    count: dict[str, int] = {}
    for _, tables in files:
        for table in tables:
            for name in table.columns:
                count[name] = count.get(name, 0) + 1
    return [
        NamedTable(table, {n if count[n] == 1 else f"{path.stem}/{n}": n for n in table.columns})
        for path, tables in files
        for table in tables
    ]


@dataclass
class Guess:
    """Guessed layout of a log.

    Attributes
    ----------
    fields : dict
        Complete fields of a layout.
    channels : dict
        Channel → name of its column. The truth channel is in `fields`.
    columns : Columns
    notes : list of str
    """

    fields: dict[str, Any]
    columns: Columns
    channels: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


class Columns:
    """All columns of a log, with their units and candidate channels."""

    def __init__(self, tables: Sequence[NamedTable], given: Mapping[str, str]) -> None:
        self.tables = tables
        self.table_of = {name: named for named in tables for name in named.columns}
        self.units: dict[str, str] = {}
        self.by_channel: dict[str, list[str]] = {}
        counted = _count_from_one(self.table_of)
        for named in tables:
            metadata = named.table.said
            for name, column in named.columns.items():
                last = leaf(name)
                parsed = (
                    Named(last) if last in _CHANNEL_NAMES else read_name(counted.get(name, name))
                )
                channel = parsed.channel
                if unit := metadata.units.get(column, parsed.unit):
                    self.units[name] = unit
                if channel is None and unit and units.known(unit) == {"time"}:
                    channel = "t"
                if metadata.time is not None:
                    channel = (
                        "t" if column == metadata.time else None if channel == "t" else channel
                    )
                if channel is not None:
                    names = self.by_channel.setdefault(channel, [])
                    place = sum(leaf(other) == channel for other in names)
                    names.insert(place if last == channel else len(names), name)
            self._name_by_file(named)
        for channel, names in self.by_channel.items():
            if channel.startswith(("i_", "theta")):  # measured columns before setpoints
                names.sort(key=is_setpoint)
        for channel, name in given.items():
            self.by_channel[channel] = [self.resolve(name)]

    def _name_by_file(self, named: NamedTable) -> None:
        """If a file has only one signal, find the signal's channel in the file name."""
        times = self.by_channel.get("t", [])
        values = [name for name in named.columns if name not in times]
        if len(self.tables) > 1 and len(values) == 1:
            (name,) = values
            channel = read_name(named.table.path.stem).channel
            if channel is not None and not any(name in names for names in self.by_channel.values()):
                self.by_channel.setdefault(channel, []).append(name)

    def resolve(self, name: str) -> str:
        """Return a column by its name, or by the end of its path if this end is unique."""
        if name in self.table_of:
            return name
        matches = [column for column in self.table_of if column.endswith((f"/{name}", f".{name}"))]
        return matches[0] if len(matches) == 1 else name

    def has_channel(self, channel: str) -> bool:
        return any(name in self.table_of for name in self.by_channel.get(channel, []))

    def column_of(self, channel: str) -> str:
        return self.by_channel.get(channel, [channel])[0]


def _count_from_one(names: Iterable[str]) -> dict[str, str]:
    """Number triples from one if they are numbered from zero, such as x[0] x[1] x[2]."""
    stems: dict[tuple[str, str], dict[int, str]] = {}
    for name in names:
        if match := _COUNTED.match(name):
            stems.setdefault((match[1], match[3]), {})[int(match[2])] = name
    return {
        name: f"{stem}{number + 1}{tail}"
        for (stem, tail), numbered in stems.items()
        if set(numbered) == {0, 1, 2}
        for number, name in numbered.items()
    }


#: Names of columns that have no real name, such as the index of a data frame.
_NAMELESS = re.compile(r"^(column 1|unnamed: 0|index|)$", re.IGNORECASE)
#: A name that ends in a digit. The digit may be in brackets, and a unit may follow.
_COUNTED = re.compile(r"^(.*?)(\d)([\])]?(?:\s*[\[({/,].*)?)$")
_CHANNEL_NAMES = (
    *("t", "theta_e", "theta_mech", "position", "speed_mech", "speed_e"),
    *dict.fromkeys(name for table in (VOLTAGES, CURRENTS) for v in table.values() for name in v),
)


def guess(
    tables: Sequence[NamedTable], fields: Mapping[str, Any], frames: Sequence[Frame]
) -> Guess:
    """Complete the fields of a layout.

    Parameters
    ----------
    tables : sequence of NamedTable
    fields : mapping
        Fields from the user.
    frames : sequence of str
        Frames that the machine allows.

    Raises
    ------
    RecordError
        No frame has all its columns, or a column has a unit that its channel cannot have.
    """
    given = {
        channel: name
        for channel, name in fields.get("columns", {}).items()
        if name != NO_COLUMN and not (channel == "udc" and "udc" in fields)
    }
    columns = Columns(tables, given)
    result = Guess(dict(fields), columns)
    frame = fields.get("frame")
    if frame is None:
        refusal = "" if given else refusal_of(columns.table_of)
        if refusal:
            raise RecordError(f"{tables[0].table.path}: {refusal}")
        frame = next(
            (candidate for candidate in frames if _is_filled(candidate, columns, fields)), None
        )
        if frame is None:
            frame = _frame_by_values(columns, frames, result)
        if frame is None:
            frame = _nearest_frame(columns, frames, fields)
        result.fields["frame"] = frame
    currents = _current_frame(frame, columns, fields)
    if currents is not None and CURRENTS[currents] != CURRENTS[frame]:
        result.fields["currents"] = currents
    used = _needed(frame, columns, fields)
    if "theta_e" in used and not columns.has_channel("theta_e") and columns.has_channel("theta"):
        columns.by_channel["theta_e"] = columns.by_channel["theta"]
    result.channels = {channel: columns.column_of(channel) for channel in used}
    _take_time(columns, fields, result)
    _take_truth(columns, frame, fields, result)
    _take_units(columns, result)
    _note_columns(fields, columns, result)
    return result


def _needed(frame: Frame, columns: Columns, fields: Mapping[str, Any]) -> list[str]:
    """Return the channels of a frame, including the third phase current if its column exists."""
    voltages = [name for name in VOLTAGES[frame] if name != "udc" or "udc" not in fields]
    if frame in ("abc", "line"):  # two of three voltages suffice
        present = [name for name in voltages if columns.has_channel(name)]
        minimum = 2 if frame == "line" or len(present) >= 2 else 3
        voltages = present if len(present) >= minimum else voltages[:minimum]
        voltages = voltages[:2] if frame == "line" else voltages
    frame_of_currents = _current_frame(frame, columns, fields) or frame
    currents = list(CURRENTS[frame_of_currents])
    if tuple(currents) == PHASE_CURRENTS:
        present = [name for name in currents if columns.has_channel(name)]
        currents = present if len(present) >= 2 else currents[:2]
    angle = ["theta_e"] if "dq" in (frame, frame_of_currents) else []
    return [*voltages, *currents, *angle]


def _current_frame(frame: Frame, columns: Columns, fields: Mapping[str, Any]) -> Frame | None:
    """Return the frame of the currents: the user's, that of the voltages, or one with columns."""
    if fields.get("currents") is not None or frame == "ports":
        given: Frame | None = fields.get("currents")
        return given
    matching: Frame = "abc" if CURRENTS[frame] == PHASE_CURRENTS else frame
    for candidate in dict.fromkeys((matching, "alphabeta", "abc", "dq")):
        minimum = 2 if candidate == "abc" else len(CURRENTS[candidate])
        if sum(columns.has_channel(name) for name in CURRENTS[candidate]) >= minimum:
            return candidate
    return None


def _is_filled(frame: Frame, columns: Columns, fields: Mapping[str, Any]) -> bool:
    return all(
        columns.has_channel(channel) or (channel == "theta_e" and columns.has_channel("theta"))
        for channel in _needed(frame, columns, fields)
    )


def _nearest_frame(columns: Columns, frames: Sequence[Frame], fields: Mapping[str, Any]) -> Frame:
    """Return the frame with the most channels, so that the error names the missing channel."""

    def share(frame: Frame) -> float:
        voltages, currents = VOLTAGES[frame][:3], CURRENTS[frame]
        return sum(
            sum(map(columns.has_channel, names)) / len(names) for names in (voltages, currents)
        )

    best = max(frames, key=share)
    if share(best) > 0 or len(frames) == 1:
        return best
    path = columns.tables[0].table.path
    named = [
        f"{name} ({columns.units[name]})" if name in columns.units else name
        for name in columns.table_of
    ]
    raise RecordError(
        f"{path}: currents and voltages are not found among its columns: {', '.join(named[:40])}. "
        f"Name the columns, e.g. --frame abc --column u_a=… u_b=… u_c=… i_a=… i_b=…; "
        f"`fluxobs channels {path}` shows the guess for each column"
    )


def _take_time(columns: Columns, fields: Mapping[str, Any], result: Guess) -> None:
    """Choose the time column of the table with the currents."""
    if fields.get("columns", {}).get("t") == NO_COLUMN:
        return
    names = columns.by_channel.get("t", [])
    if "t" in fields.get("columns", {}):
        result.channels["t"] = names[0]
        return
    base = base_table(columns, result.channels)
    for name in names:
        if columns.table_of.get(name) is base and not _is_index(base, name):
            result.channels["t"] = name
            return
    for name, column in base.columns.items():
        if _NAMELESS.match(leaf(column)) and _looks_like_time(base.read(name, rows=1000)):
            columns.by_channel["t"] = [name]
            result.channels["t"] = name
            result.notes.append(f"{name!r} rises evenly and is taken as t (otherwise --column t=-)")
            return


def _looks_like_time(values: Array) -> bool:
    """Return whether values rise by similar steps, but are not row numbers."""
    steps = np.diff(values)
    if len(steps) < 10 or not np.isfinite(steps).all() or not steps.min() > 0:
        return False
    usual = float(np.median(steps))
    return bool(np.median(np.abs(steps - usual)) < 0.2 * usual and not (steps == 1).all())


def _is_index(named: NamedTable, name: str) -> bool:
    """Return whether a column holds only row numbers and the file states the sample time."""
    if named.table.said.sample_time is None:
        return False
    head = named.read(name, rows=1000)
    return bool(len(head) > 1 and (np.diff(head) == 1).all())


def base_table(columns: Columns, channels: Mapping[str, str]) -> NamedTable:
    """Return the table that contains the first current."""
    name = next((column for channel, column in channels.items() if channel.startswith("i_")), "")
    return columns.table_of.get(name, columns.tables[0])


def _take_truth(columns: Columns, frame: Frame, fields: Mapping[str, Any], result: Guess) -> None:
    truth = dict(fields.get("truth", {}))
    if NO_TRUTH in truth:
        result.fields["truth"] = {}
        return
    if truth:
        result.fields["truth"] = {
            channel: ",".join(columns.resolve(name.strip()) for name in given.split(","))
            if channel in ("hall", "sincos") and given not in columns.table_of
            else columns.resolve(given)
            for channel, given in truth.items()
        }
        return
    if frame == "ports":
        return
    used = set(result.channels.values())
    for channel in ("theta_e", "theta_mech"):
        if columns.has_channel(channel) and columns.column_of(channel) not in used:
            result.fields["truth"] = {channel: columns.column_of(channel)}
            return
    if columns.has_channel("theta") and columns.column_of("theta") not in used:
        # the angle's values decide whether the angle is electrical or mechanical
        result.fields["truth"] = {"theta": columns.column_of("theta")}
    elif columns.has_channel("sin") and columns.has_channel("cos"):
        result.fields["truth"] = {
            "sincos": f"{columns.column_of('sin')},{columns.column_of('cos')}"
        }
    elif all(columns.has_channel(f"hall_{phase}") for phase in "abc"):
        result.fields["truth"] = {"hall": ",".join(columns.column_of(f"hall_{p}") for p in "abc")}
    elif columns.has_channel("hall"):
        result.fields["truth"] = {"hall": columns.column_of("hall")}


# ---- units ---------------------------------------------------------------------------------


def _take_units(columns: Columns, result: Guess) -> None:
    """Find the units in the file, or in the names, or else guess them from the values."""
    fields = result.fields
    chosen = dict(fields.get("unit", {}))
    truth = {} if "theta" in fields.get("truth", {}) else fields.get("truth", {})
    expected = [*result.channels.values(), *fields.get("truth", {}).values()]
    for named in columns.tables:
        named.table.expect([named.columns[name] for name in expected if name in named.columns])
    for channel, name in [*result.channels.items(), *truth.items()]:
        if name not in columns.table_of or _has_conversion(channel, fields):
            continue
        unit = columns.units.get(name)
        kind = units.quantity(channel)
        if kind is None:
            continue
        possible = units.known(unit) if unit else set()
        if unit and kind in possible:
            chosen[channel] = units.plain(unit)
        elif possible:
            scale = {"current": "AMPERES_PER_VOLT", "voltage": "VOLTS_PER_AMPERE"}.get(kind, "…")
            raise RecordError(
                f"{columns.tables[0].table.path}: the column {name!r} is taken as {channel}, but "
                f"is in {unit}. Give the scale of the probe (--scale {channel}={scale}), or "
                f"the right column (--column {channel}=COLUMN)"
            )
        elif guessed := _unit_by_values(channel, columns.table_of[name].read(name)):
            chosen[channel] = guessed
            note = _UNIT_NOTES[kind].format(channel=channel, unit=guessed)
            result.notes += [note] if note not in result.notes else []
    if chosen:
        result.fields["unit"] = chosen


_UNIT_NOTES = {
    "time": "t has no unit; its steps suggest {unit} (otherwise --unit t=…)",
    "angle": "{channel} has no unit; its wraps suggest {unit} (otherwise --unit {channel}=…)",
    "duty": "duties have no unit; their size suggests {unit} (otherwise --unit duty=…)",
}


def _has_conversion(channel: str, fields: Mapping[str, Any]) -> bool:
    """Return whether the user gave a unit, a converter or a scale for the channel."""
    return any(key in fields.get(table, {}) for table in CONVERTING for key in keys_for(channel))


def _unit_by_values(channel: str, values: Array) -> str | None:
    kind = units.quantity(channel)
    values = values[np.isfinite(values)]
    if len(values) < 2:
        return None
    if kind == "time":
        steps = np.diff(values)
        step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
        for unit, factor in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)):
            if STEPS[0] <= step * factor * (1 + 1e-9) < STEPS[1]:
                return None if unit == "s" else unit
    elif kind == "angle":
        return turn_of(values)
    elif kind == "duty":
        largest = float(np.abs(values).max())
        if largest <= DUTY_MOST and values.min() < -NEGATIVE:
            return "-1..1"
        return "%" if DUTY_MOST < largest <= PERCENT else None
    return None


def turn_of(angle: Array) -> str | None:
    """Return the unit of an angle from its wraps, or None for radians or if it never wraps."""
    steps = np.abs(np.diff(angle))
    steps = steps[np.isfinite(steps)]
    if len(steps) == 0 or not steps.max() > 0:
        return None
    usual = float(np.median(steps))
    for turn, unit in TURNS.items():
        wraps = np.abs(steps - turn) < max(0.1 * turn, 3 * usual)
        if wraps.any() and steps.max() < 1.2 * turn and usual < 0.2 * turn:
            return unit
    return None


# ---- values --------------------------------------------------------------------------------


def _frame_by_values(columns: Columns, frames: Sequence[Frame], result: Guess) -> Frame | None:
    """If units distinguish currents and voltages, assign them in the order of the file."""
    if "abc" not in frames:
        return None
    sets: dict[str, list[str]] = {"current": [], "voltage": []}
    for name, unit in columns.units.items():
        kinds = units.known(unit) & set(sets)
        if len(kinds) == 1 and not any(name in names for names in columns.by_channel.values()):
            sets[kinds.pop()].append(name)
    currents = _select_alternating(columns, sets["current"])
    voltages = _select_alternating(columns, sets["voltage"])
    arrangements = (_arrangement(columns, currents), _arrangement(columns, voltages))
    layouts: dict[tuple[str | None, str | None, int], tuple[Frame, tuple[str, ...]]] = {
        ("axes", "axes", 2): ("alphabeta", VOLTAGES["alphabeta"]),
        ("phases", "phases", 3): ("abc", VOLTAGES["abc"]),
        ("phases", "phases", 2): ("line", VOLTAGES["line"][:2]),
    }
    layout = layouts.get((*arrangements, len(voltages)))
    if layout is None:
        return None
    frame, names = layout
    for channel, name in zip((*names, *CURRENTS[frame]), (*voltages, *currents), strict=False):
        columns.by_channel[channel] = [name]
    note = (
        "units and angles between columns identify currents and voltages; the order of phases is "
        "taken from the file. `fluxobs check` tests this order"
    )
    if frame != "alphabeta" and len(voltages) == 3:
        note += ", and whether the voltages are line-to-line"
    result.notes.append(note)
    return frame


def _select_alternating(columns: Columns, names: Sequence[str]) -> list[str]:
    """Return the columns whose standard deviation exceeds half of the mean value."""
    alternating = []
    for name in names:
        values = columns.table_of[name].read(name)
        values = values[np.isfinite(values)]
        if len(values) and values.std() > 0.5 * abs(values.mean()) and values.std() > 0:
            alternating.append(name)
    return alternating


def _arrangement(columns: Columns, names: Sequence[str]) -> str | None:
    """Return "phases" for columns 120° apart, "axes" for columns 90° apart, and None otherwise."""
    if len(names) not in (2, 3):
        return None
    values = [columns.table_of[name].read(name) for name in names]
    rows = min(map(len, values))
    centred = [v[:rows] - np.nanmean(v[:rows]) for v in values]
    cosines = [
        float(np.nansum(a * b) / math.sqrt(np.nansum(a * a) * np.nansum(b * b)))
        for n, a in enumerate(centred)
        for b in centred[n + 1 :]
    ]
    for arrangement, cosine in BETWEEN.items():
        if all(abs(measured - cosine) < NEAR for measured in cosines):
            return arrangement
    return None


# ---- notes ---------------------------------------------------------------------------------


def _note_columns(fields: Mapping[str, Any], columns: Columns, result: Guess) -> None:
    """Note the guessed columns, unless all columns have the names of their channels."""
    given = fields.get("columns", {})
    assignments = []
    plain = True
    for channel, name in result.channels.items():
        if channel.startswith("i_") and is_setpoint(name):
            result.notes.append(
                f"{name} is a setpoint by its name, but the measured current is needed "
                f"(otherwise --column {channel}=COLUMN)"
            )
        if channel in given or name not in columns.table_of:
            continue
        unit = result.fields.get("unit", {}).get(channel)
        guessed = unit is not None and channel not in fields.get("unit", {})
        if name == channel and not guessed:
            continue
        plain = False
        shown = guessed and units.plain(str(unit)) not in units.plain(name)
        assignments.append(f"{channel} = {name}" + (f" [{unit}]" if shown else ""))
    truth = result.fields.get("truth", {})
    if truth and not fields.get("truth"):
        ((channel, name),) = truth.items()
        meaning = "Hall signals" if channel == "hall" else "the true angle"
        result.notes.append(
            f"{name} is taken as {meaning}, to score the estimate (otherwise --truth none)"
        )
    frame = result.fields["frame"]
    phases = [name for name in VOLTAGES["abc"] if name in result.channels]
    if frame == "abc" and len(phases) == 2 and all(map(columns.has_channel, phases)):
        (third,) = set(VOLTAGES["abc"]) - set(phases)
        result.notes.append(
            f"{third} is taken as -({phases[0]} + {phases[1]}), as for phase-to-neutral voltages"
        )
    if not plain:
        result.notes.insert(0, f"columns are taken as {', '.join(assignments)}; frame {frame}")


def electrical_or_mechanical(angle: Array, vector: NDArray[np.complex128]) -> str:
    """Return "theta_e" if an angle [rad] turns as fast as the current, else "theta_mech"."""
    finite = np.isfinite(angle) & np.isfinite(vector)
    if finite.sum() < 10:
        return "theta_e"
    turned = np.abs(np.unwrap(angle[finite])[[0, -1]] @ [-1, 1])
    electrical = np.abs(np.unwrap(np.angle(vector[finite]))[[0, -1]] @ [-1, 1])
    return "theta_e" if not turned > 0 or electrical < 1.5 * turned else "theta_mech"
