"""Tables on uniform rows: gaps filled with missing values, jittering samples resampled, files
joined.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array
from .clock import INDEXED, Clock
from .formats.table import BATCH, Columns, Table
from .resample import Course, resample

#: Rows of the file beyond those in between that a resampled row may need.
AROUND = 4


class FilledTable(Table):
    """A table with its gaps filled: rows that are missing are NaN.

    Parameters
    ----------
    table : Table
    clock : Clock
        Of this table.
    time : str
        Its time column, which becomes uniform; it need not exist.
    """

    def __init__(self, table: Table, clock: Clock, time: str) -> None:
        self.table, self.clock, self.time = table, clock, time
        self.path, self.columns, self.said = table.path, table.columns, table.said
        self.rows = clock.rows
        self.random_access = table.random_access

    def place(self, row: int) -> str:
        return self.table.place(self._source(row))

    def _source(self, row: int) -> int:
        """The row of the file at a uniform row, or the last one before it."""
        piece = int(np.searchsorted(self.clock.at, row, side="right")) - 1
        found = int(self.clock.source[piece] + row - self.clock.at[piece])
        after = self.clock.source[piece + 1] if piece + 1 < len(self.clock.at) else self.table.rows
        return min(found, int(after) - 1)

    def batches(
        self, names: Sequence[str], first: int, last: int, size: int = BATCH
    ) -> Iterator[Columns]:
        wanted = [name for name in dict.fromkeys(names) if name != self.time]
        row = first
        begin, end = self._source(first), self._source(last - 1) + 1
        source = begin
        parts = self.table.batches(wanted or [self.table.columns[0]], begin, end, size)
        for part in parts:
            count = len(next(iter(part.values())))
            at = self.clock.uniform_rows(np.arange(source, source + count))
            source += count
            at, keep = at[(at >= row) & (at < last)], (at >= row) & (at < last)
            stop = last if source >= end else int(at[-1]) + 1 if len(at) else row
            for cut in range(row, stop, size):
                to = min(cut + size, stop)
                yield self._filled(part, at, keep, cut, to) | self._times(names, cut, to)
            row = stop

    def _times(self, names: Sequence[str], first: int, last: int) -> Columns:
        if self.time not in names:
            return {}
        return {self.time: self.clock.times(np.arange(first, last))}

    @staticmethod
    def _filled(
        part: Columns, at: NDArray[np.int64], keep: NDArray[np.bool_], first: int, last: int
    ) -> Columns:
        inside = (at >= first) & (at < last)
        out = {}
        for name, values in part.items():
            column = np.full(last - first, np.nan)
            column[at[inside] - first] = values[keep][inside]
            out[name] = column
        return out


class SequentialReader:
    """Rows of a table read once, in order; the last ones are kept for who comes back a little."""

    def __init__(self, table: Table, names: Sequence[str], first: int, size: int) -> None:
        self._parts = table.batches(names, first, table.rows, size)
        self._kept: Columns = {name: np.empty(0) for name in names}
        self._first, self._rows, self._table = first, first, table

    def get(self, first: int, last: int) -> tuple[int, Columns]:
        """Rows from `first`, or the first one there is, to before `last`, and its number."""
        first, last = max(first, self._first), min(last, self._table.rows)
        while self._rows < last:
            part = next(self._parts)
            drop = max(0, first - self._first)
            self._kept = {
                name: np.concatenate([kept[drop:], part[name]]) for name, kept in self._kept.items()
            }
            self._first = self._first + drop
            self._rows += len(next(iter(part.values())))
        low = max(0, first - self._first)
        high = max(low, last - self._first)
        return self._first + low, {name: kept[low:high] for name, kept in self._kept.items()}


class ResampledTable(Table):
    """Columns of a table at other times: those of stamps that jitter, or of another file.

    Parameters
    ----------
    table : Table
        Its stamps may jitter; without `time` it is uniform.
    time : (str, float, float), optional
        Column of the stamps, its scale and offset; else the rows are uniform.
    own : Clock
        Of `table`.
    clock : Clock
        Of the result.
    courses : dict
        Column → how it goes on between samples.
    scales : dict
        Column → what turns an angle into radians.
    shift : float
        What is added to the table's own times [s].
    """

    def __init__(
        self,
        table: Table,
        own: Clock,
        clock: Clock,
        courses: Mapping[str, Course],
        scales: Mapping[str, float],
        time: tuple[str, float, float] | None = None,
        shift: float = 0.0,
    ) -> None:
        self.table, self.own, self.clock, self.time = table, own, clock, time
        self.courses, self.scales, self.shift = courses, scales, shift
        self.path, self.columns, self.said = table.path, table.columns, table.said
        self.rows, self.random_access = clock.rows, table.random_access

    def place(self, row: int) -> str:
        low, _ = self._needed(self.clock.times(np.array([row])))
        return self.table.place(min(max(low + AROUND, 0), self.table.rows - 1))

    def _needed(self, t: Array) -> tuple[int, int]:
        """Rows of the table that are needed for these times."""
        begin, end = t[0] - self.shift, t[-1] + self.clock.sample_time - self.shift
        if self.time is None:
            low, high = (self.own.row_at(one, False) for one in (begin, end))
            return low - AROUND, high + AROUND
        found = np.searchsorted(self.own.index, [begin, end])
        return max(int(found[0]) - 1, 0) * INDEXED - AROUND, int(found[1]) * INDEXED + AROUND

    def batches(
        self, names: Sequence[str], first: int, last: int, size: int = BATCH
    ) -> Iterator[Columns]:
        names = list(dict.fromkeys(names))
        stamps = [] if self.time is None else [self.time[0]]
        wanted = [name for name in names if name not in stamps]
        low, _ = self._needed(self.clock.times(np.array([first])))
        rows = SequentialReader(
            self.table, [*wanted, *stamps], min(max(0, low), self.table.rows), size
        )
        for cut in range(first, last, size):
            t = self.clock.times(np.arange(cut, min(cut + size, last)))
            at, part = rows.get(*self._needed(t))
            if self.time is None:
                s = self.own.times(np.arange(at, at + len(next(iter(part.values())))))
            else:
                column, scale, offset = self.time
                s = part[column] * scale + offset
                s = self._unwrapped(s, at) if self.own.wrap and len(s) else s
            out = {name: self._at(name, s + self.shift, part[name], t) for name in wanted}
            gap = self._in_gap(cut, len(t))
            for values in out.values():
                values[gap] = np.nan
            yield out | {name: t for name in stamps if name in names}

    def _in_gap(self, first: int, count: int) -> NDArray[np.bool_]:
        """Rows that lie in a gap of the stamps."""
        if self.time is None or len(self.own.at) == 1:
            return np.zeros(count, bool)
        rows = np.arange(first, first + count)
        piece = np.searchsorted(self.own.at, rows, side="right") - 1
        length = np.append(np.diff(self.own.source), self.table.rows)
        return np.asarray(rows - self.own.at[piece] >= length[piece])

    def _unwrapped(self, s: Array, at: int) -> Array:
        """Stamps without wraps, from the index of their times."""
        near = self.own.index[min(at // INDEXED, len(self.own.index) - 1)]
        turns = np.round((near - s[0]) / self.own.wrap)
        jumps = np.concatenate([[0.0], np.cumsum(np.diff(s) < 0)])
        return np.asarray(s + (turns + jumps) * self.own.wrap)

    def _at(self, name: str, s: Array, values: Array, t: Array) -> Array:
        course = self.courses.get(name, "smooth")
        if len(s) < 2:
            return np.full(len(t), np.nan)
        scale = self.scales.get(name, 1.0) if course == "angle" else 1.0
        found = resample(course, s, values * scale, t, self.clock.sample_time)
        return found if scale == 1.0 else np.asarray(found / scale)


class JoinedTable(Table):
    """Columns of several tables, all on the rows of the first."""

    def __init__(self, tables: Sequence[Table], names: Sequence[Mapping[str, str]]) -> None:
        self.tables, self._names = tables, names
        self.path, self.rows = tables[0].path, tables[0].rows
        self.said = tables[0].said
        self.random_access = all(table.random_access for table in tables)
        self._of = {name: n for n, known in enumerate(names) for name in known}
        self.columns = list(self._of)

    def place(self, row: int) -> str:
        return self.tables[0].place(row)

    def batches(
        self, names: Sequence[str], first: int, last: int, size: int = BATCH
    ) -> Iterator[Columns]:
        readers = []
        for n in sorted({self._of[name] for name in names}):
            wanted = {name: self._names[n][name] for name in names if self._of[name] == n}
            own = list(dict.fromkeys(wanted.values()))
            table = self.tables[n]
            readers.append((wanted, Pieces(table.batches(own, first, last, size))))
        for cut in range(first, last, size):
            count = min(size, last - cut)
            out: Columns = {}
            for wanted, pieces in readers:
                part = pieces.take(count)
                out |= {name: part[column] for name, column in wanted.items()}
            yield out


class Pieces:
    """Batches, cut anew."""

    def __init__(self, parts: Iterator[Columns]) -> None:
        self._parts = parts
        self._left: Columns = {}

    def take(self, count: int) -> Columns:
        """The next rows."""
        while not self._left or len(next(iter(self._left.values()))) < count:
            part = next(self._parts)
            self._left = {
                name: np.concatenate([self._left[name], values]) if self._left else values
                for name, values in part.items()
            }
        out = {name: values[:count] for name, values in self._left.items()}
        self._left = {name: values[count:] for name, values in self._left.items()}
        return out
