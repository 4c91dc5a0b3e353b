"""The interface to a file of columns, the same for every format."""

from __future__ import annotations

import difflib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...core.arrays import Array
from ...errors import RecordError

Columns = dict[str, Array]

#: Default rows per batch: small enough that memory is reused rather than mapped anew.
BATCH = 50_000


@dataclass(frozen=True)
class Said:
    """What a file says of itself, besides names and numbers.

    Attributes
    ----------
    units : dict
        Column → unit, as written.
    time : str, optional
        The column that holds the time.
    sample_time : float, optional
        [s], of a file whose header has the rate.
    start : float
        Time of the first row [s], where sample_time gives the rest.
    notes : tuple of str
        What a reader should know: lines left out, for example.
    """

    units: dict[str, str] = field(default_factory=dict)
    time: str | None = None
    sample_time: float | None = None
    start: float = 0.0
    notes: tuple[str, ...] = ()


class Table(ABC):
    """Named columns of numbers, read in batches so that files larger than memory can stream.

    Attributes
    ----------
    path : Path
    columns : list of str
        A column in a group has the path "group/column".
    rows : int
    random_access : bool
        Whether it can read rows in the middle without reading those before them.
    said : Said
    """

    path: Path
    columns: list[str]
    rows: int
    random_access: bool = True
    said: Said = Said()

    @abstractmethod
    def batches(
        self, names: Sequence[str], first: int, last: int, size: int = BATCH
    ) -> Iterator[Columns]:
        """Yield columns of rows first … last - 1 in order; missing values are NaN.

        Raises RecordError with file, column and place if a value is not a number.
        """

    def expect(self, names: Sequence[str]) -> None:  # noqa: B027  (most formats need not know)
        """Columns that will all be read: a format that parses all of a file for one reads them
        together."""

    def place(self, row: int) -> str:
        """Where a person finds that row in the file."""
        return f"row {row + 1}"


def read_rows(table: Table, names: Sequence[str], first: int, last: int) -> Columns:
    """Columns of rows first … last - 1 in one piece."""
    parts = list(table.batches(names, first, last))
    return {name: np.concatenate([np.empty(0), *(part[name] for part in parts)]) for name in names}


def missing_column(
    path: Path,
    columns: Sequence[str],
    name: str,
    channel: str,
    option: str,
    also: Sequence[str] = (),
) -> RecordError:
    """The error for a missing column; it names the nearest columns, or all of them, and further
    channels that are missing."""
    near = difflib.get_close_matches(name, columns, n=3, cutoff=0.4)
    hint = f"nearest: {', '.join(near)}" if near else f"it has: {', '.join(columns[:40])}"
    return RecordError(
        f"{path}: no column {name!r} for the channel {channel}; {hint}. "
        f"Name it with {option} {channel}=COLUMN"
        + (f"; {' and '.join(also)} {'is' if len(also) == 1 else 'are'} missing too" * bool(also))
    )
