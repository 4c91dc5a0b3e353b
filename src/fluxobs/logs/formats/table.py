"""Interface to a file of columns, common to all formats."""

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

#: Default rows per batch: small enough that memory is reused, not mapped again.
BATCH = 50_000


@dataclass(frozen=True)
class Said:
    """Metadata of a file: all that the file states besides names and numbers.

    Attributes
    ----------
    units : dict
        Column → unit as written in the file.
    time : str, optional
        Time column.
    sample_time : float, optional
        Sample time [s], if the header states this time or the sample rate.
    start : float
        Time of the first row [s]; the other times follow from sample_time.
    notes : tuple of str
        Notes for the user, e.g. on omitted lines.
    """

    units: dict[str, str] = field(default_factory=dict)
    time: str | None = None
    sample_time: float | None = None
    start: float = 0.0
    notes: tuple[str, ...] = ()


class Table(ABC):
    """Named numeric columns, read in batches so that files larger than memory can stream.

    Attributes
    ----------
    path : Path
    columns : list of str
        A column in a group has the path "group/column".
    rows : int
    random_access : bool
        Whether rows in the middle can be read without the rows before.
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

        Raise RecordError, which names file, column and place, if a value is not a number.
        """

    def expect(self, names: Sequence[str]) -> None:  # noqa: B027  (most formats need not know)
        """Announce columns that will all be read.

        With this, a format that would parse the whole file for each column parses it once.
        """

    def place(self, row: int) -> str:
        """Return the place of a row in the file, for a message."""
        return f"row {row + 1}"


def read_rows(table: Table, names: Sequence[str], first: int, last: int) -> Columns:
    """Read columns of rows first … last - 1 as one batch."""
    batches = list(table.batches(names, first, last))
    return {
        name: np.concatenate([np.empty(0), *(batch[name] for batch in batches)]) for name in names
    }


def missing_column(
    path: Path,
    columns: Sequence[str],
    name: str,
    channel: str,
    option: str,
    also: Sequence[str] = (),
) -> RecordError:
    """Return the error for a missing column. The message lists the nearest columns or the first 40
    columns, and other missing channels.
    """
    near = difflib.get_close_matches(name, columns, n=3, cutoff=0.4)
    hint = f"nearest: {', '.join(near)}" if near else f"the file has: {', '.join(columns[:40])}"
    return RecordError(
        f"{path}: no column {name!r} for the channel {channel}; {hint}. "
        f"Name the column with {option} {channel}=COLUMN"
        + (f"; {' and '.join(also)} {'is' if len(also) == 1 else 'are'} missing too" * bool(also))
    )
