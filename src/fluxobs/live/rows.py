"""Rows of a stream, as they arrived."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..logs.formats.table import Columns


class StreamRows(NamedTuple):
    """Some rows: their columns as they were sent, and their lines if the stream is text."""

    columns: Columns
    lines: bytes

    @property
    def rows(self) -> int:
        """How many they are."""
        return len(next(iter(self.columns.values()), ()))

    def at(self, which: NDArray[np.bool_]) -> StreamRows:
        """Those of the rows for which `which` is true."""
        columns = {name: values[which] for name, values in self.columns.items()}
        if not self.lines:
            return StreamRows(columns, b"")
        lines = self.lines.split(b"\n")
        return StreamRows(columns, b"".join([lines[int(k)] + b"\n" for k in np.flatnonzero(which)]))


def joined(one: StreamRows, other: StreamRows) -> StreamRows:
    """The rows of both."""
    columns = {
        name: np.concatenate([values, other.columns[name]]) for name, values in one.columns.items()
    }
    return StreamRows(columns, one.lines + other.lines)
