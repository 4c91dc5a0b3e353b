"""List the columns of files, with the channel guessed for each column."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FluxobsError
from ..formats import Table, open_tables, read_rows
from .guess import ROTATING, Columns, NamedTable, guess, name_columns
from .names import read_name
from .units import factor

#: Number of rows from which range and sample time are computed, and number of values shown.
ROWS, SHOWN = 50_000, 3


@dataclass(frozen=True)
class Channel:
    """Column of a file.

    Attributes
    ----------
    column : str
    unit : str
        From the file or from the column's name; empty if no unit is given.
    rows : int
    sample_time : float or None
        Sample time of the column's table [s].
    low, high : float
        Range of the first 50 000 rows; NaN for a column without numbers.
    first : tuple of float
    taken_for : str
        Guessed channel; empty if the column would not be used.
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
        """The attributes as JSON values."""
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
    """Columns of files, and notes on the layout guessed from all columns."""

    channels: tuple[Channel, ...]
    notes: tuple[str, ...]


def list_channels(*paths: str | Path, header: str | None = None) -> Listing:
    """List the columns of files that belong to one log.

    Parameters
    ----------
    paths : path
    header : str, optional
        Names of the columns, separated by commas, for a file without names.

    Raises
    ------
    RecordError
        A file cannot be read.
    """
    names = None if header is None else [name.strip() for name in header.split(",")]
    files = [(Path(path), open_tables(path, names)) for path in paths]
    named_tables = name_columns(files)
    notes = [note for _, tables in files for table in tables for note in table.said.notes]
    columns = Columns(named_tables, {})
    taken: dict[str, str] = {}
    try:
        guessed = guess(named_tables, {}, ROTATING)
        available = guessed.columns.table_of
        taken = {name: channel for channel, name in guessed.channels.items()}
        columns, truth = guessed.columns, guessed.fields.get("truth", {})
        for channel, source in truth.items():
            for name in [source] if source in columns.table_of else source.split(","):
                taken[name] = "true angle" if channel == "theta" else f"truth {channel}"
        notes += guessed.notes
        missing = [channel for channel, name in guessed.channels.items() if name not in available]
        if missing:
            notes.append(
                f"no column found for {', '.join(missing)}: give --column {missing[0]}=COLUMN"
            )
    except FluxobsError as error:
        notes.append(str(error))
    channels = [
        _channel(named, name, columns, taken.get(name, ""))
        for named in named_tables
        for name in named.columns
    ]
    return Listing(tuple(channels), tuple(notes))


def _channel(named: NamedTable, name: str, columns: Columns, taken_for: str) -> Channel:
    table, column = named.table, named.columns[name]
    unit = columns.units.get(name, "")
    rows = min(ROWS, table.rows)
    try:
        values = read_rows(table, [column], 0, rows)[column] if rows else np.zeros(0)
    except FluxobsError:  # for example, the column holds text
        values = np.full(rows, np.nan)
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (np.nan, np.nan)
    first = tuple(float(value) for value in values[:SHOWN])
    return Channel(
        name, unit, table.rows, _sample_time(named, columns), low, high, first, taken_for
    )


def _sample_time(named: NamedTable, columns: Columns) -> float | None:
    table: Table = named.table
    if table.said.sample_time is not None:
        return table.said.sample_time
    time = table.said.time or next(
        (column for name, column in named.columns.items() if read_name(name).channel == "t"), None
    )
    if time is None or table.rows < 3:
        return None
    t = read_rows(table, [time], 0, min(ROWS, table.rows))[time]
    name = next(name for name, column in named.columns.items() if column == time)
    unit = columns.units.get(name)
    step = float(np.nanmedian(np.diff(t)))
    return step * (factor("t", unit) if unit else 1.0) if step > 0 else None
