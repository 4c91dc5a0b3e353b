"""Tables on uniform rows: fill gaps, resample jittering samples, join files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ...core.arrays import Array
from ..formats.table import BATCH, Columns, Table
from .clock import INDEXED, Clock
from .resample import Course, resample

#: Extra rows on each side that resampling may need.
AROUND = 4


class FilledTable(Table):
    """Table whose gaps are filled: missing rows are NaN.

    Parameters
    ----------
    table : Table
    clock : Clock
        Clock of `table`.
    time : str
        Time column of `table`, replaced by uniform times; this column need not exist.
    """

    def __init__(self, table: Table, clock: Clock, time: str) -> None:
        self.table, self.clock, self.time = table, clock, time
        self.path, self.columns, self.said = table.path, table.columns, table.said
        self.rows = clock.rows
        self.random_access = table.random_access

    def place(self, row: int) -> str:
        return self.table.place(self._source_row(row))

    def _source_row(self, row: int) -> int:
        """Return the row of the file at a uniform row, or the last row of the file before."""
        piece = int(np.searchsorted(self.clock.at, row, side="right")) - 1
        source = int(self.clock.source[piece] + row - self.clock.at[piece])
        after = self.clock.source[piece + 1] if piece + 1 < len(self.clock.at) else self.table.rows
        return min(source, int(after) - 1)

    def batches(
        self, names: Sequence[str], first: int, last: int, size: int = BATCH
    ) -> Iterator[Columns]:
        wanted = [name for name in dict.fromkeys(names) if name != self.time]
        row = first
        begin, end = self._source_row(first), self._source_row(last - 1) + 1
        source = begin
        batches = self.table.batches(wanted or [self.table.columns[0]], begin, end, size)
        for batch in batches:
            count = len(next(iter(batch.values())))
            rows = self.clock.uniform_rows(np.arange(source, source + count))
            source += count
            rows, inside = (
                rows[(rows >= row) & (rows < last)],
                (rows >= row) & (rows < last),
            )
            stop = last if source >= end else int(rows[-1]) + 1 if len(rows) else row
            for start in range(row, stop, size):
                upper = min(start + size, stop)
                yield self._fill(batch, rows, inside, start, upper) | self._times(
                    names, start, upper
                )
            row = stop

    def _times(self, names: Sequence[str], first: int, last: int) -> Columns:
        if self.time not in names:
            return {}
        return {self.time: self.clock.times(np.arange(first, last))}

    @staticmethod
    def _fill(
        batch: Columns,
        rows: NDArray[np.int64],
        selected: NDArray[np.bool_],
        first: int,
        last: int,
    ) -> Columns:
        inside = (rows >= first) & (rows < last)
        filled = {}
        for name, values in batch.items():
            column = np.full(last - first, np.nan)
            column[rows[inside] - first] = values[selected][inside]
            filled[name] = column
        return filled


class SequentialReader:
    """Reader that reads a table once, in order, and keeps the last rows for the next request."""

    def __init__(self, table: Table, names: Sequence[str], first: int, size: int) -> None:
        self._batches = table.batches(names, first, table.rows, size)
        self._kept: Columns = {name: np.empty(0) for name in names}
        self._first, self._rows, self._table = first, first, table

    def get(self, first: int, last: int) -> tuple[int, Columns]:
        """Return (number of the first row, rows) for the available rows of first … last - 1."""
        first, last = max(first, self._first), min(last, self._table.rows)
        while self._rows < last:
            batch = next(self._batches)
            drop = max(0, first - self._first)
            self._kept = {
                name: np.concatenate([kept[drop:], batch[name]])
                for name, kept in self._kept.items()
            }
            self._first = self._first + drop
            self._rows += len(next(iter(batch.values())))
        lower = max(0, first - self._first)
        upper = max(lower, last - self._first)
        return self._first + lower, {name: kept[lower:upper] for name, kept in self._kept.items()}


class ResampledTable(Table):
    """Columns of a table, resampled to uniform times or to the times of another file.

    Parameters
    ----------
    table : Table
        Source; its stamps may jitter. Without `time`, its rows are uniform.
    time : (str, float, float), optional
        Column of the stamps, and the scale and offset of this column.
    source_clock : Clock
        Clock of `table`.
    clock : Clock
        Clock of the result.
    courses : dict
        Column → course of the column between samples.
    scales : dict
        Column → factor that converts an angle to radians.
    shift : float
        Time added to the times of `table` [s].
    """

    def __init__(
        self,
        table: Table,
        source_clock: Clock,
        clock: Clock,
        courses: Mapping[str, Course],
        scales: Mapping[str, float],
        time: tuple[str, float, float] | None = None,
        shift: float = 0.0,
    ) -> None:
        self.table, self.source_clock, self.clock, self.time = table, source_clock, clock, time
        self.courses, self.scales, self.shift = courses, scales, shift
        self.path, self.columns, self.said = table.path, table.columns, table.said
        self.rows, self.random_access = clock.rows, table.random_access

    def place(self, row: int) -> str:
        lower, _ = self._needed_rows(self.clock.times(np.array([row])))
        return self.table.place(min(max(lower + AROUND, 0), self.table.rows - 1))

    def _needed_rows(self, t: Array) -> tuple[int, int]:
        """Return the range (first, last) of source rows that the times `t` need."""
        begin, end = t[0] - self.shift, t[-1] + self.clock.sample_time - self.shift
        if self.time is None:
            lower, upper = (self.source_clock.row_at(time, False) for time in (begin, end))
            return lower - AROUND, upper + AROUND
        places = np.searchsorted(self.source_clock.index, [begin, end])
        return max(int(places[0]) - 1, 0) * INDEXED - AROUND, int(places[1]) * INDEXED + AROUND

    def batches(
        self, names: Sequence[str], first: int, last: int, size: int = BATCH
    ) -> Iterator[Columns]:
        names = list(dict.fromkeys(names))
        stamps = [] if self.time is None else [self.time[0]]
        wanted = [name for name in names if name not in stamps]
        lower, _ = self._needed_rows(self.clock.times(np.array([first])))
        reader = SequentialReader(
            self.table, [*wanted, *stamps], min(max(0, lower), self.table.rows), size
        )
        for start in range(first, last, size):
            t = self.clock.times(np.arange(start, min(start + size, last)))
            row, batch = reader.get(*self._needed_rows(t))
            if self.time is None:
                times = self.source_clock.times(
                    np.arange(row, row + len(next(iter(batch.values()))))
                )
            else:
                column, scale, offset = self.time
                times = batch[column] * scale + offset
                times = (
                    self._unwrapped(times, row) if self.source_clock.wrap and len(times) else times
                )
            columns = {
                name: self._resample_column(name, times + self.shift, batch[name], t)
                for name in wanted
            }
            gap = self._in_gap(start, len(t))
            for values in columns.values():
                values[gap] = np.nan
            yield columns | {name: t for name in stamps if name in names}

    def _in_gap(self, first: int, count: int) -> NDArray[np.bool_]:
        """Return which rows lie in a gap of the stamps."""
        if self.time is None or len(self.source_clock.at) == 1:
            return np.zeros(count, bool)
        rows = np.arange(first, first + count)
        piece = np.searchsorted(self.source_clock.at, rows, side="right") - 1
        length = np.append(np.diff(self.source_clock.source), self.table.rows)
        return np.asarray(rows - self.source_clock.at[piece] >= length[piece])

    def _unwrapped(self, s: Array, row: int) -> Array:
        """Return stamps without wraps; the time index gives the number of wraps."""
        reference = self.source_clock.index[min(row // INDEXED, len(self.source_clock.index) - 1)]
        turns = np.round((reference - s[0]) / self.source_clock.wrap)
        jumps = np.concatenate([[0.0], np.cumsum(np.diff(s) < 0)])
        return np.asarray(s + (turns + jumps) * self.source_clock.wrap)

    def _resample_column(self, name: str, s: Array, values: Array, t: Array) -> Array:
        course = self.courses.get(name, "smooth")
        if len(s) < 2:
            return np.full(len(t), np.nan)
        scale = self.scales.get(name, 1.0) if course == "angle" else 1.0
        resampled = resample(course, s, values * scale, t, self.clock.sample_time)
        return resampled if scale == 1.0 else np.asarray(resampled / scale)


class JoinedTable(Table):
    """Columns of several tables, on the rows of the first table."""

    def __init__(self, tables: Sequence[Table], names: Sequence[Mapping[str, str]]) -> None:
        self.tables, self._names = tables, names
        self.path, self.rows = tables[0].path, tables[0].rows
        self.said = tables[0].said
        self.random_access = all(table.random_access for table in tables)
        self._table_of = {name: n for n, columns in enumerate(names) for name in columns}
        self.columns = list(self._table_of)

    def place(self, row: int) -> str:
        return self.tables[0].place(row)

    def batches(
        self, names: Sequence[str], first: int, last: int, size: int = BATCH
    ) -> Iterator[Columns]:
        readers = []
        for n in sorted({self._table_of[name] for name in names}):
            wanted = {name: self._names[n][name] for name in names if self._table_of[name] == n}
            columns = list(dict.fromkeys(wanted.values()))
            table = self.tables[n]
            readers.append((wanted, Rebatcher(table.batches(columns, first, last, size))))
        for start in range(first, last, size):
            count = min(size, last - start)
            joined: Columns = {}
            for wanted, rebatcher in readers:
                batch = rebatcher.take(count)
                joined |= {name: batch[column] for name, column in wanted.items()}
            yield joined


class Rebatcher:
    """Batches that are cut again to other lengths."""

    def __init__(self, batches: Iterator[Columns]) -> None:
        self._batches = batches
        self._rest: Columns = {}

    def take(self, count: int) -> Columns:
        """Return the next `count` rows."""
        while not self._rest or len(next(iter(self._rest.values()))) < count:
            batch = next(self._batches)
            self._rest = {
                name: np.concatenate([self._rest[name], values]) if self._rest else values
                for name, values in batch.items()
            }
        taken = {name: values[:count] for name, values in self._rest.items()}
        self._rest = {name: values[count:] for name, values in self._rest.items()}
        return taken
