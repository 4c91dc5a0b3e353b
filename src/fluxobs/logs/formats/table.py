"""What a file of columns has to offer, whatever its format."""

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

#: Rows a batch by default: small enough that memory is reused rather than mapped anew.
BATCH = 50_000


class Table(Protocol):
    """Named columns of numbers, read in batches so that files larger than memory stream."""

    path: Path
    columns: list[str]
    rows: int
    random_access: bool  # rows in the middle are read without reading all before them

    def batches(
        self, names: Sequence[str], first: int, last: int, size: int = BATCH
    ) -> Iterator[Columns]:
        """Columns of rows first … last - 1 in order; missing values are NaN.

        Raises RecordError with file, column and place where a value is no number.
        """
        ...

    def place(self, row: int) -> str:
        """How a person finds that row in the file."""
        ...


def read_rows(table: Table, names: Sequence[str], first: int, last: int) -> Columns:
    """The same in one piece."""
    parts = list(table.batches(names, first, last))
    return {name: np.concatenate([part[name] for part in parts]) for name in names}


def missing_column(table: Table, name: str, channel: str, option: str) -> RecordError:
    """The error for a column that is not there: says which are, nearest first."""
    near = difflib.get_close_matches(name, table.columns, n=3, cutoff=0.4)
    hint = f"nearest: {', '.join(near)}" if near else f"it has: {', '.join(table.columns)}"
    return RecordError(
        f"{table.path}: no column {name!r} for the channel {channel}; {hint}. "
        f"Name it with {option} {channel}=COLUMN"
    )
