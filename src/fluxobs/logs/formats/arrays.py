"""Tables from arrays in memory: a mapping of names to columns, such as a data frame."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import RecordError
from .table import BATCH, Columns, Table

#: Placeholder for a path in messages.
NAME = Path("arrays")


class ArrayTable(Table):
    """Numeric columns of equal length.

    Raises
    ------
    RecordError
        A column is not a numeric vector, or columns differ in length.
    """

    def __init__(self, columns: Mapping[str, Any], path: Path = NAME) -> None:
        self.path = path
        self._arrays: Columns = {}
        for name, values in columns.items():
            try:
                array = np.asarray(values, dtype=float)
            except (TypeError, ValueError):
                raise RecordError(f"{path}: column {name!r} must hold numbers") from None
            if array.ndim != 1:
                raise RecordError(
                    f"{path}: column {name!r} must have shape (rows,), got {array.shape}"
                )
            self._arrays[str(name)] = array
        self.columns = list(self._arrays)
        lengths = {len(array) for array in self._arrays.values()}
        if len(lengths) > 1:
            sizes = ", ".join(f"{name} {len(array)}" for name, array in self._arrays.items())
            raise RecordError(f"{path}: the columns differ in length: {sizes}")
        self.rows = lengths.pop() if lengths else 0

    def within(self, group: str) -> ArrayTable:
        """Return the table with its columns renamed to "group/name"."""
        table = ArrayTable(
            {f"{group}/{name}": array for name, array in self._arrays.items()}, self.path
        )
        units = {f"{group}/{name}": unit for name, unit in self.said.units.items()}
        time = None if self.said.time is None else f"{group}/{self.said.time}"
        table.said = replace(self.said, units=units, time=time)
        return table

    def batches(
        self, names: Sequence[str], first: int, last: int, size: int = BATCH
    ) -> Iterator[Columns]:
        for start in range(first, last, size):
            stop = min(start + size, last)
            yield {name: self._arrays[name][start:stop] for name in names}
