"""Rows of a stream as received."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..logs.formats.table import Columns


class StreamRows(NamedTuple):
    """Rows of a stream: their columns as sent, and their lines if the stream is text."""

    columns: Columns
    lines: bytes

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(next(iter(self.columns.values()), ()))

    def at(self, mask: NDArray[np.bool_]) -> StreamRows:
        """Return the rows where `mask` is true."""
        columns = {name: values[mask] for name, values in self.columns.items()}
        if not self.lines:
            return StreamRows(columns, b"")
        lines = self.lines.split(b"\n")
        return StreamRows(columns, b"".join([lines[int(k)] + b"\n" for k in np.flatnonzero(mask)]))


def joined(earlier: StreamRows, later: StreamRows) -> StreamRows:
    """Return the rows of both arguments, the earlier rows first."""
    columns = {
        name: np.concatenate([values, later.columns[name]])
        for name, values in earlier.columns.items()
    }
    return StreamRows(columns, earlier.lines + later.lines)
