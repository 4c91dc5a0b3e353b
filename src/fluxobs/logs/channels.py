"""The columns of a file, and what each would be taken for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FluxobsError
from .formats import Table, open_tables, read_rows
from .guess import ROTATING, Columns, NamedTable, guess, parts_of
from .names import read_name
from .units import factor

#: Rows from which range and rate are taken, and values that are shown.
ROWS, SHOWN = 50_000, 3


@dataclass(frozen=True)
class Channel:
    """A column of a file.

    Attributes
    ----------
    column : str
    unit : str
        As the file or the name says it; empty if neither does.
    rows : int
    sample_time : float or None
        [s], of the table that it is in.
    low, high : float
        Range of its first 50 000 rows; NaN for columns that are no numbers.
    first : tuple of float
    taken_for : str
        Channel; empty if it would not be used.
    """

    column: str
    unit: str
    rows: int
    sample_time: float | None
    low: float
    high: float
    first: tuple[float, ...]
    taken_for: str

    @property
    def facts(self) -> dict[str, Any]:
        """The same, for JSON."""
        return {
            "column": self.column,
            "unit": self.unit,
            "rows": self.rows,
            "sample_time": self.sample_time,
            "range": [self.low, self.high] if np.isfinite([self.low, self.high]).all() else None,
            "first": [value if np.isfinite(value) else None for value in self.first],
            "taken_for": self.taken_for,
        }


@dataclass(frozen=True)
class Listing:
    """The channels of files, and words on what they would be taken for together."""

    channels: tuple[Channel, ...]
    notes: tuple[str, ...]


def list_channels(*paths: str | Path, header: str | None = None) -> Listing:
    """List the columns of files that belong to one log.

    Parameters
    ----------
    paths : path
    header : str, optional
        Names of the columns, parted by commas, for a file that has none.

    Raises
    ------
    RecordError
        A file cannot be read.
    """
    names = None if header is None else [name.strip() for name in header.split(",")]
    files = [(Path(path), open_tables(path, names)) for path in paths]
    parts = parts_of(files)
    notes = [note for _, tables in files for table in tables for note in table.said.notes]
    columns = Columns(parts, {})
    taken: dict[str, str] = {}
    try:
        found = guess(parts, {}, ROTATING)
        taken_from = found.columns.part_of
        taken = {name: channel for channel, name in found.channels.items()}
        columns, truth = found.columns, found.fields.get("truth", {})
        for channel, several in truth.items():
            for name in [several] if several in columns.part_of else several.split(","):
                taken[name] = "true angle" if channel == "theta" else f"truth {channel}"
        notes += found.notes
        missing = [channel for channel, name in found.channels.items() if name not in taken_from]
        if missing:
            notes.append(f"nothing is found for {', '.join(missing)}: --column {missing[0]}=COLUMN")
    except FluxobsError as error:
        notes.append(str(error))
    channels = [
        _channel(part, name, columns, taken.get(name, ""))
        for part in parts
        for name in part.columns
    ]
    return Listing(tuple(channels), tuple(notes))


def _channel(part: NamedTable, name: str, columns: Columns, taken_for: str) -> Channel:
    table, column = part.table, part.columns[name]
    unit = columns.units.get(name, "")
    rows = min(ROWS, table.rows)
    try:
        values = read_rows(table, [column], 0, rows)[column] if rows else np.zeros(0)
    except FluxobsError:  # text, for example
        values = np.full(rows, np.nan)
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (np.nan, np.nan)
    first = tuple(float(value) for value in values[:SHOWN])
    return Channel(name, unit, table.rows, _sample_time(part, columns), low, high, first, taken_for)


def _sample_time(part: NamedTable, columns: Columns) -> float | None:
    table: Table = part.table
    if table.said.sample_time is not None:
        return table.said.sample_time
    time = table.said.time or next(
        (column for name, column in part.columns.items() if read_name(name).channel == "t"), None
    )
    if time is None or table.rows < 3:
        return None
    t = read_rows(table, [time], 0, min(ROWS, table.rows))[time]
    name = next(name for name, column in part.columns.items() if column == time)
    unit = columns.units.get(name)
    step = float(np.nanmedian(np.diff(t)))
    return step * (factor("t", unit) if unit else 1.0) if step > 0 else None
