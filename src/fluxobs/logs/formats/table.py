"""The interface to a file of columns, the same for every format."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...errors import RecordError

Array = NDArray[np.float64]
Columns = dict[str, Array]

#: Default rows per batch: small enough that memory is reused rather than mapped anew.
BATCH = 50_000


class Table(Protocol):
    """Named columns of numbers, read in batches so that files larger than memory can stream."""

    path: Path
    columns: list[str]
    rows: int
    random_access: bool  # can read rows in the middle without reading those before them

    def batches(
        self, names: Sequence[str], first: int, last: int, size: int = BATCH
    ) -> Iterator[Columns]:
        """Yield columns of rows first … last - 1 in order; missing values are NaN.

        Raises RecordError with file, column and place if a value is not a number.
        """
        ...

    def place(self, row: int) -> str:
        """Where a person finds that row in the file."""
        ...


def read_rows(table: Table, names: Sequence[str], first: int, last: int) -> Columns:
    """Columns of rows first … last - 1 in one piece."""
    parts = list(table.batches(names, first, last))
    return {name: np.concatenate([part[name] for part in parts]) for name in names}


def missing_column(table: Table, name: str, channel: str, option: str) -> RecordError:
    """The error for a missing column; it names the nearest columns, or all of them."""
    near = difflib.get_close_matches(name, table.columns, n=3, cutoff=0.4)
    hint = f"nearest: {', '.join(near)}" if near else f"it has: {', '.join(table.columns)}"
    return RecordError(
        f"{table.path}: no column {name!r} for the channel {channel}; {hint}. "
        f"Name it with {option} {channel}=COLUMN"
    )
