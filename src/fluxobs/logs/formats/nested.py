"""Nested data, as in MATLAB and HDF5 files: paths name the columns; a table has one length."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...core.arrays import Array
from ...errors import RecordError
from ..meaning.names import key, read_name
from .table import BATCH, Columns, Said, Table
from .timing import INTERVAL, RATE, START

#: Largest number of columns of a matrix. An array with more columns is an image, or its data are
#: transposed.
MOST_COLUMNS = 256
#: Arrays with fewer rows are parameters, not signals.
LEAST_ROWS = 8


@dataclass
class Contents:
    """Columns and numbers found in a file.

    Attributes
    ----------
    columns : dict
        Path → (number of rows, function that reads rows first … last - 1).
    units : dict
    numbers : dict
        Path → scalar.
    """

    columns: dict[str, tuple[int, Callable[[int, int], Any]]] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    numbers: dict[str, float] = field(default_factory=dict)

    def add(self, path: str, data: Any, unit: str | None = None) -> None:
        """Add an array, or an object with shape and dtype that can be sliced like an array."""
        shape, kind = tuple(data.shape), np.dtype(data.dtype)
        if kind.names:
            for name in kind.names:
                self._column(f"{path}/{name}", len(data), field_of(data, name), unit)
        elif kind.kind not in "fiub":
            return
        elif int(np.prod(shape)) == 1:
            self.numbers[path] = float(np.asarray(data[()]).ravel()[0])
        elif len(shape) == 1 or (len(shape) == 2 and 1 in shape):
            flat = len(shape) == 1
            axis = 0 if flat else int(np.argmax(shape))
            self._column(path, max(shape), line_of(data, None if flat else axis, 0), unit)
        elif len(shape) == 2 and min(shape) <= MOST_COLUMNS:
            axis = int(np.argmax(shape))
            for n in range(min(shape)):
                self._column(f"{path}[{n}]", max(shape), line_of(data, axis, n), unit)

    def _column(
        self, path: str, rows: int, read: Callable[[int, int], Any], unit: str | None
    ) -> None:
        if rows >= LEAST_ROWS:
            self.columns[path] = (rows, read)
            if unit:
                self.units[path] = unit


def field_of(data: Any, name: str) -> Callable[[int, int], Any]:
    """Return the function that reads a field of a structured array."""
    return lambda first, last: data[first:last][name]


def line_of(data: Any, axis: int | None, n: int) -> Callable[[int, int], Any]:
    """Return the function that reads column n of a matrix whose rows are along `axis`.

    A vector has the axis None.
    """
    if axis is None:
        return lambda first, last: data[first:last]
    if axis == 0:
        return lambda first, last: data[first:last, n]
    return lambda first, last: data[n, first:last]


class NestedTable(Table):
    """Columns of equal length."""

    def __init__(self, path: Path, contents: Contents, columns: Sequence[str]) -> None:
        self.path = path
        self.columns = list(columns)
        self.rows = contents.columns[columns[0]][0]
        self._read = {name: contents.columns[name][1] for name in columns}
        interval, start = _timing(contents.numbers)
        units = {name: unit for name, unit in contents.units.items() if name in self._read}
        self.said = Said(units, None, interval, start)

    def batches(
        self, names: Sequence[str], first: int, last: int, size: int = BATCH
    ) -> Iterator[Columns]:
        for start in range(first, last, size):
            stop = min(start + size, last)
            try:
                yield {name: _floats(self._read[name](start, stop)) for name in names}
            except (OSError, ValueError, KeyError, TypeError) as error:
                raise RecordError(f"{self.path}: reading failed midway: {error}") from None


def _floats(values: Any) -> Array:
    return np.asarray(values, dtype=float).ravel()


def _timing(numbers: Mapping[str, float]) -> tuple[float | None, float]:
    """Return (sample time, start) from scalars whose names mean a sample time, rate or start."""
    interval, start = None, 0.0
    for path, value in numbers.items():
        word = key(path.rsplit("/", 1)[-1])
        if word in INTERVAL and value > 0:
            interval = value
        elif word in RATE and value > 0 and interval is None:
            interval = 1 / value
        elif word in START or word == "tstart":
            start = value
    return interval, start


def tables(path: Path, contents: Contents) -> list[Table]:
    """Return tables with columns of equal length; a group with its own time is a separate table."""
    by_length: dict[int, list[str]] = defaultdict(list)
    for name, (rows, _) in contents.columns.items():
        by_length[rows].append(name)
    nested_tables: list[Table] = []
    for names in sorted(by_length.values(), key=len, reverse=True):
        nested_tables += [NestedTable(path, contents, columns) for columns in _split_by_time(names)]
    return nested_tables


def _split_by_time(names: list[str]) -> list[list[str]]:
    groups: dict[str, list[str]] = defaultdict(list)
    for name in names:
        groups[name.rpartition("/")[0]].append(name)
    timed = [
        group for group in groups.values() if any(read_name(name).channel == "t" for name in group)
    ]
    if len(timed) < 2:
        return [names]
    rest = [name for group in groups.values() if group not in timed for name in group]
    return [*timed, *([rest] if rest else [])]
