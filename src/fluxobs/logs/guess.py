"""What the columns of a file are taken for, where the user does not say it.

Names and units decide; where they do not, the values of columns with known units. All that is
guessed is said in `notes`, in words that the user can check.
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

from ..core.arrays import Array
from ..errors import RecordError
from ..machines.model.frames import CURRENTS, PHASE_CURRENTS, VOLTAGES, Frame
from . import units
from .formats import Table, read_rows
from .layout import CONVERTING, NO_COLUMN, NO_TRUTH, words_for
from .names import Named, is_setpoint, leaf, read_name

#: Rows that are looked at.
ROWS = 20_000
#: Frames in which rotating machines are logged, the one that needs no conversion first.
ROTATING: tuple[Frame, ...] = ("alphabeta", "abc", "line", "duty", "dq")
#: A time step is taken to be of this range [s]; it is one of thousand, so only one unit fits.
STEPS = (2e-5, 2e-2)
#: Cosines of the angles between two phases, and how far noise and offsets move them.
BETWEEN = {"phases": -0.5, "axes": 0.0}
NEAR = 0.2
#: A duty below minus this is one of −1 … 1.
NEGATIVE = 0.02
#: What an angle's wrap shows: size of a full turn → its unit.
TURNS = {
    360.0: "deg",
    1.0: "turn",
    65536.0: "counts:65536",
    32768.0: "counts:32768",
    16384.0: "counts:16384",
    8192.0: "counts:8192",
    4096.0: "counts:4096",
}
#: A duty beyond this is no share of the DC link, but may be percent.
DUTY_MOST, PERCENT = 1.5, 100.0


@dataclass(frozen=True)
class NamedTable:
    """A table of the log, and the names by which its columns are known."""

    table: Table
    columns: dict[str, str]  # name here → column

    def read(self, name: str, first: int = 0, rows: int = ROWS) -> Array:
        """Rows of a column."""
        last = min(first + rows, self.table.rows)
        return read_rows(self.table, [self.columns[name]], first, last)[self.columns[name]]


def parts_of(files: Sequence[tuple[Path, list[Table]]]) -> list[NamedTable]:
    """Name the columns of all tables: as they are, or "file/column" where files share a name."""
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
    """What a log is taken for.

    Attributes
    ----------
    fields : dict
        Fields of a layout, completed.
    channels : dict
        Channel → name of its column; of truth, all that it needs.
    columns : Columns
    notes : list of str
    """

    fields: dict[str, Any]
    columns: Columns
    channels: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


class Columns:
    """All columns of a log, and what their names and units say."""

    def __init__(self, parts: Sequence[NamedTable], given: Mapping[str, str]) -> None:
        self.parts = parts
        self.part_of = {name: part for part in parts for name in part.columns}
        self.units: dict[str, str] = {}
        self.by_channel: dict[str, list[str]] = {}
        counted = _from_one(self.part_of)
        for part in parts:
            said = part.table.said
            for name, column in part.columns.items():
                exact = leaf(name)
                read = Named(exact) if exact in _KNOWN else read_name(counted.get(name, name))
                channel = read.channel
                if unit := said.units.get(column, read.unit):
                    self.units[name] = unit
                if channel is None and unit and units.known(unit) == {"time"}:
                    channel = "t"
                if said.time is not None:
                    channel = "t" if column == said.time else None if channel == "t" else channel
                if channel is not None:
                    found = self.by_channel.setdefault(channel, [])
                    first = sum(leaf(one) == channel for one in found)
                    found.insert(first if exact == channel else len(found), name)
            self._by_file(part)
        for channel, names in self.by_channel.items():
            if channel.startswith(("i_", "theta")):  # measured ones go first
                names.sort(key=is_setpoint)
        for channel, name in given.items():
            self.by_channel[channel] = [self.resolve(name)]

    def _by_file(self, part: NamedTable) -> None:
        """The only value of a file may be named by the file."""
        times = self.by_channel.get("t", [])
        values = [name for name in part.columns if name not in times]
        if len(self.parts) > 1 and len(values) == 1:
            (name,) = values
            channel = read_name(part.table.path.stem).channel
            if channel is not None and not any(name in all_ for all_ in self.by_channel.values()):
                self.by_channel.setdefault(channel, []).append(name)

    def resolve(self, name: str) -> str:
        """A column by its name, or by the end of its path if that is unique."""
        if name in self.part_of:
            return name
        ends = [one for one in self.part_of if one.endswith((f"/{name}", f".{name}"))]
        return ends[0] if len(ends) == 1 else name

    def has(self, channel: str) -> bool:
        return any(name in self.part_of for name in self.by_channel.get(channel, []))

    def of(self, channel: str) -> str:
        return self.by_channel.get(channel, [channel])[0]


def _from_one(names: Iterable[str]) -> dict[str, str]:
    """Names of three that are counted from zero, as x[0] x[1] x[2], counted from one."""
    stems: dict[tuple[str, str], dict[int, str]] = {}
    for name in names:
        if found := _COUNTED.match(name):
            stems.setdefault((found[1], found[3]), {})[int(found[2])] = name
    return {
        name: f"{stem}{n + 1}{rest}"
        for (stem, rest), of in stems.items()
        if set(of) == {0, 1, 2}
        for n, name in of.items()
    }


#: Names of a column that has none, as of the index of a data frame.
_NAMELESS = re.compile(r"^(column 1|unnamed: 0|index|)$", re.IGNORECASE)
#: A name that ends in a digit, perhaps in brackets, perhaps before a unit.
_COUNTED = re.compile(r"^(.*?)(\d)([\])]?(?:\s*[\[({/,].*)?)$")
_KNOWN = (
    *("t", "theta_e", "theta_mech", "position", "speed_mech", "speed_e"),
    *dict.fromkeys(name for table in (VOLTAGES, CURRENTS) for v in table.values() for name in v),
)


def guess(parts: Sequence[NamedTable], fields: Mapping[str, Any], frames: Sequence[Frame]) -> Guess:
    """Complete the fields of a layout.

    Parameters
    ----------
    parts : sequence of Part
    fields : mapping
        What the user gave.
    frames : sequence of str
        Those that the machine may have.

    Raises
    ------
    RecordError
        No frame is filled, or a column has a unit that its channel cannot have.
    """
    given = {
        channel: name
        for channel, name in fields.get("columns", {}).items()
        if name != NO_COLUMN and not (channel == "udc" and "udc" in fields)
    }
    columns = Columns(parts, given)
    out = Guess(dict(fields), columns)
    frame = fields.get("frame")
    if frame is None:
        frame = next((one for one in frames if _filled(one, columns, fields)), None)
        if frame is None:
            frame = _by_values(columns, frames, out)
        if frame is None:
            frame = _nearest_frame(columns, frames, fields)
        out.fields["frame"] = frame
    currents = _current_frame(frame, columns, fields)
    if currents is not None and CURRENTS[currents] != CURRENTS[frame]:
        out.fields["currents"] = currents
    used = _needed(frame, columns, fields)
    if "theta_e" in used and not columns.has("theta_e") and columns.has("theta"):
        columns.by_channel["theta_e"] = columns.by_channel["theta"]
    out.channels = {channel: columns.of(channel) for channel in used}
    _take_time(columns, fields, out)
    _take_truth(columns, frame, fields, out)
    _take_units(columns, out)
    _say(fields, columns, out)
    return out


def _needed(frame: Frame, columns: Columns, fields: Mapping[str, Any]) -> list[str]:
    """Channels of a frame, with the third phase current if there is one."""
    voltages = [name for name in VOLTAGES[frame] if name != "udc" or "udc" not in fields]
    if frame in ("abc", "line"):  # two of three will do
        present = [name for name in voltages if columns.has(name)]
        least = 2 if frame == "line" or len(present) >= 2 else 3
        voltages = present if len(present) >= least else voltages[:least]
        voltages = voltages[:2] if frame == "line" else voltages
    frame_of_currents = _current_frame(frame, columns, fields) or frame
    currents = list(CURRENTS[frame_of_currents])
    if tuple(currents) == PHASE_CURRENTS:
        present = [name for name in currents if columns.has(name)]
        currents = present if len(present) >= 2 else currents[:2]
    angle = ["theta_e"] if "dq" in (frame, frame_of_currents) else []
    return [*voltages, *currents, *angle]


def _current_frame(frame: Frame, columns: Columns, fields: Mapping[str, Any]) -> Frame | None:
    """The frame of the currents: as given, that of the voltages, or another one that is filled."""
    if fields.get("currents") is not None or frame == "ports":
        given: Frame | None = fields.get("currents")
        return given
    own: Frame = "abc" if CURRENTS[frame] == PHASE_CURRENTS else frame
    for one in dict.fromkeys((own, "alphabeta", "abc", "dq")):
        least = 2 if one == "abc" else len(CURRENTS[one])
        if sum(columns.has(name) for name in CURRENTS[one]) >= least:
            return one
    return None


def _filled(frame: Frame, columns: Columns, fields: Mapping[str, Any]) -> bool:
    return all(
        columns.has(channel) or (channel == "theta_e" and columns.has("theta"))
        for channel in _needed(frame, columns, fields)
    )


def _nearest_frame(columns: Columns, frames: Sequence[Frame], fields: Mapping[str, Any]) -> Frame:
    """The frame of which most channels are there: its first missing one will be named."""

    def share(frame: Frame) -> float:
        voltages, currents = VOLTAGES[frame][:3], CURRENTS[frame]
        return sum(sum(map(columns.has, names)) / len(names) for names in (voltages, currents))

    best = max(frames, key=share)
    if share(best) > 0 or len(frames) == 1:
        return best
    path = columns.parts[0].table.path
    named = [
        f"{name} ({columns.units[name]})" if name in columns.units else name
        for name in columns.part_of
    ]
    raise RecordError(
        f"{path}: currents and voltages are not found among its columns: {', '.join(named[:40])}. "
        f"Name them, as --frame abc --column u_a=… u_b=… u_c=… i_a=… i_b=…; "
        f"`fluxobs channels {path}` shows what each column would be taken for"
    )


def _take_time(columns: Columns, fields: Mapping[str, Any], out: Guess) -> None:
    """The time column of the part that has the currents."""
    if fields.get("columns", {}).get("t") == NO_COLUMN:
        return
    names = columns.by_channel.get("t", [])
    if "t" in fields.get("columns", {}):
        out.channels["t"] = names[0]
        return
    base = base_part(columns, out.channels)
    for name in names:
        if columns.part_of.get(name) is base and not _is_index(base, name):
            out.channels["t"] = name
            return
    for name, column in base.columns.items():
        if _NAMELESS.match(leaf(column)) and _looks_like_time(base.read(name, rows=1000)):
            columns.by_channel["t"] = [name]
            out.channels["t"] = name
            out.notes.append(f"{name!r}, which rises evenly, is taken for t (else --column t=-)")
            return


def _looks_like_time(values: Array) -> bool:
    """Whether values rise by steps that are alike, and are no numbers of rows."""
    steps = np.diff(values)
    if len(steps) < 10 or not np.isfinite(steps).all() or not steps.min() > 0:
        return False
    usual = float(np.median(steps))
    return bool(np.median(np.abs(steps - usual)) < 0.2 * usual and not (steps == 1).all())


def _is_index(part: NamedTable, name: str) -> bool:
    """Whether a column only counts rows, where the file says the sample time."""
    if part.table.said.sample_time is None:
        return False
    head = part.read(name, rows=1000)
    return bool(len(head) > 1 and (np.diff(head) == 1).all())


def base_part(columns: Columns, channels: Mapping[str, str]) -> NamedTable:
    """The part that has the first current."""
    name = next((one for channel, one in channels.items() if channel.startswith("i_")), "")
    return columns.part_of.get(name, columns.parts[0])


def _take_truth(columns: Columns, frame: Frame, fields: Mapping[str, Any], out: Guess) -> None:
    truth = dict(fields.get("truth", {}))
    if NO_TRUTH in truth:
        out.fields["truth"] = {}
        return
    if truth:
        out.fields["truth"] = {
            channel: ",".join(columns.resolve(name.strip()) for name in given.split(","))
            if channel in ("hall", "sincos") and given not in columns.part_of
            else columns.resolve(given)
            for channel, given in truth.items()
        }
        return
    if frame == "ports":
        return
    taken = set(out.channels.values())
    for channel in ("theta_e", "theta_mech"):
        if columns.has(channel) and columns.of(channel) not in taken:
            out.fields["truth"] = {channel: columns.of(channel)}
            return
    if columns.has("theta") and columns.of("theta") not in taken:
        out.fields["truth"] = {"theta": columns.of("theta")}  # electrical or mechanical: by values
    elif columns.has("sin") and columns.has("cos"):
        out.fields["truth"] = {"sincos": f"{columns.of('sin')},{columns.of('cos')}"}
    elif all(columns.has(f"hall_{phase}") for phase in "abc"):
        out.fields["truth"] = {"hall": ",".join(columns.of(f"hall_{p}") for p in "abc")}
    elif columns.has("hall"):
        out.fields["truth"] = {"hall": columns.of("hall")}


# ---- units ---------------------------------------------------------------------------------


def _take_units(columns: Columns, out: Guess) -> None:
    """Units from the file, from names, and where neither says one, from values that tell it."""
    given = out.fields
    chosen = dict(given.get("unit", {}))
    truth = {} if "theta" in given.get("truth", {}) else given.get("truth", {})
    named = [*out.channels.values(), *given.get("truth", {}).values()]
    for part in columns.parts:
        part.table.expect([part.columns[name] for name in named if name in part.columns])
    for channel, name in [*out.channels.items(), *truth.items()]:
        if name not in columns.part_of or _is_given(channel, given):
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
                f"{columns.parts[0].table.path}: the column {name!r} is taken for {channel}, but "
                f"is in {unit}. Give what a probe's volt means, --scale {channel}={scale}, or "
                f"the right column, --column {channel}=COLUMN"
            )
        elif found := _unit_by_values(channel, columns.part_of[name].read(name)):
            chosen[channel] = found
            note = _VALUES_SAY[kind].format(channel=channel, unit=found)
            out.notes += [note] if note not in out.notes else []
    if chosen:
        out.fields["unit"] = chosen


_VALUES_SAY = {
    "time": "t has no unit; by its steps it is taken to be in {unit} (else --unit t=…)",
    "angle": "{channel} has no unit; by its wraps it is taken to be in {unit} "
    "(else --unit {channel}=…)",
    "duty": "duties have no unit; by their size they are taken to be in {unit} (else --unit "
    "duty=…)",
}


def _is_given(channel: str, fields: Mapping[str, Any]) -> bool:
    """Whether the user said a unit, a converter or a scale."""
    return any(word in fields.get(given, {}) for given in CONVERTING for word in words_for(channel))


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
        most = float(np.abs(values).max())
        if most <= DUTY_MOST and values.min() < -NEGATIVE:
            return "-1..1"
        return "%" if DUTY_MOST < most <= PERCENT else None
    return None


def turn_of(angle: Array) -> str | None:
    """The unit of an angle by what it wraps at; None for radians, or if it does not wrap."""
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


def _by_values(columns: Columns, frames: Sequence[Frame], out: Guess) -> Frame | None:
    """Currents and voltages in the order of the file, where units tell one from the other."""
    if "abc" not in frames:
        return None
    sets: dict[str, list[str]] = {"current": [], "voltage": []}
    for name, unit in columns.units.items():
        kinds = units.known(unit) & set(sets)
        if len(kinds) == 1 and not any(name in names for names in columns.by_channel.values()):
            sets[kinds.pop()].append(name)
    currents = _rotating(columns, sets["current"])
    voltages = _rotating(columns, sets["voltage"])
    how = (_arrangement(columns, currents), _arrangement(columns, voltages))
    chosen: dict[tuple[str | None, str | None, int], tuple[Frame, tuple[str, ...]]] = {
        ("axes", "axes", 2): ("alphabeta", VOLTAGES["alphabeta"]),
        ("phases", "phases", 3): ("abc", VOLTAGES["abc"]),
        ("phases", "phases", 2): ("line", VOLTAGES["line"][:2]),
    }
    found = chosen.get((*how, len(voltages)))
    if found is None:
        return None
    frame, names = found
    for channel, name in zip((*names, *CURRENTS[frame]), (*voltages, *currents), strict=False):
        columns.by_channel[channel] = [name]
    words = (
        "their units, and the angles between them, say which columns are currents and which are "
        "voltages; their order is that of the file. `fluxobs check` tells whether it is right"
    )
    if frame != "alphabeta" and len(voltages) == 3:
        words += ", and whether the voltages are line to line"
    out.notes.append(words)
    return frame


def _rotating(columns: Columns, names: Sequence[str]) -> list[str]:
    """Columns that swing about a mean by more than their mean."""
    out = []
    for name in names:
        values = columns.part_of[name].read(name)
        values = values[np.isfinite(values)]
        if len(values) and values.std() > 0.5 * abs(values.mean()) and values.std() > 0:
            out.append(name)
    return out


def _arrangement(columns: Columns, names: Sequence[str]) -> str | None:
    """Whether columns are phases, 120° apart, or axes, 90° apart."""
    if len(names) not in (2, 3):
        return None
    values = [columns.part_of[name].read(name) for name in names]
    rows = min(map(len, values))
    centred = [v[:rows] - np.nanmean(v[:rows]) for v in values]
    cosines = [
        float(np.nansum(a * b) / math.sqrt(np.nansum(a * a) * np.nansum(b * b)))
        for n, a in enumerate(centred)
        for b in centred[n + 1 :]
    ]
    for word, cosine in BETWEEN.items():
        if all(abs(one - cosine) < NEAR for one in cosines):
            return word
    return None


# ---- words ---------------------------------------------------------------------------------


def _say(fields: Mapping[str, Any], columns: Columns, out: Guess) -> None:
    """One note on the columns that were not named by the user, if any is not what it is called."""
    given = fields.get("columns", {})
    words = []
    plain = True
    for channel, name in out.channels.items():
        if channel.startswith("i_") and is_setpoint(name):
            out.notes.append(
                f"{name} is a setpoint by its name, but the measured current is needed "
                f"(else --column {channel}=COLUMN)"
            )
        if channel in given or name not in columns.part_of:
            continue
        unit = out.fields.get("unit", {}).get(channel)
        told = unit is not None and channel not in fields.get("unit", {})
        plain = plain and name == channel and not told
        seen = told and units.plain(str(unit)) not in units.plain(name)
        words.append(f"{channel} = {name}" + (f" [{unit}]" if seen else ""))
    truth = out.fields.get("truth", {})
    if truth and not fields.get("truth"):
        ((channel, name),) = truth.items()
        what = "Hall signals" if channel == "hall" else "the true angle"
        out.notes.append(f"{name} is taken for {what}, to score the estimate (else --truth none)")
    frame = out.fields["frame"]
    phases = [name for name in VOLTAGES["abc"] if name in out.channels]
    if frame == "abc" and len(phases) == 2 and all(map(columns.has, phases)):
        (third,) = set(VOLTAGES["abc"]) - set(phases)
        out.notes.append(
            f"{third} is taken as -({phases[0]} + {phases[1]}), which is right for voltages from "
            f"phase to neutral"
        )
    if not plain:
        out.notes.insert(0, f"columns are taken as {', '.join(words)}; frame {frame}")


def electrical_or_mechanical(angle: Array, vector: NDArray[np.complex128]) -> str:
    """Whether an angle [rad] turns as fast as the current does, or more slowly."""
    good = np.isfinite(angle) & np.isfinite(vector)
    if good.sum() < 10:
        return "theta_e"
    turned = np.abs(np.unwrap(angle[good])[[0, -1]] @ [-1, 1])
    electrical = np.abs(np.unwrap(np.angle(vector[good]))[[0, -1]] @ [-1, 1])
    return "theta_e" if not turned > 0 or electrical < 1.5 * turned else "theta_mech"
