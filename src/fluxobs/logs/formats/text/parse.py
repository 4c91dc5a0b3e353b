"""Parse lines of delimited text with Polars."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Self

import polars as pl

from ....core.arrays import Array
from ..lazy import BROKEN
from .structure import Structure

#: Column for surplus cells, beyond the header; lines with surplus cells are refused.
_SURPLUS = "surplus"


class Ragged(ValueError):
    """Lines have different numbers of cells."""


class Cells:
    """Cells of several lines, accessed by column number.

    Attributes
    ----------
    rows : int
    """

    def __init__(self, frame: pl.DataFrame) -> None:
        self._frame = frame
        self.rows = frame.height

    @classmethod
    def of(
        cls, block: bytes, structure: Structure, numbers: Collection[int], texts: Collection[int]
    ) -> Self:
        """Split lines into the wanted columns.

        Raises
        ------
        Ragged
            A line has too many cells.
        """
        wanted = {*numbers, *texts}
        schema: dict[str, type[pl.DataType]] = {
            str(n): pl.Float64 if n in numbers else pl.String for n in range(len(structure.names))
        }
        lazy = pl.scan_csv(
            block,
            separator=structure.delimiter,
            has_header=False,
            schema=schema | {_SURPLUS: pl.String},
            decimal_comma=structure.decimal_comma,
            ignore_errors=True,
            encoding="utf8-lossy",
            missing_columns="insert",
        )
        try:
            return cls(lazy.select([*(str(n) for n in sorted(wanted)), _SURPLUS]).collect())
        except BROKEN as error:
            raise Ragged(str(error).split("\n")[0]) from None

    def between(self, first: int, last: int) -> Cells:
        """Return the cells of lines first … last - 1."""
        return Cells(self._frame.slice(first, last - first))

    @property
    def surplus(self) -> bool:
        """Whether a line has non-empty cells beyond the last column."""
        beyond = self._frame[_SURPLUS].drop_nulls()
        return bool(len(beyond) and (beyond.str.strip_chars() != "").any())

    def number(self, n: int) -> tuple[Array, bool]:
        """Return (numbers of a column, whether all cells are numbers); other cells are NaN."""
        values = self._frame[str(n)]
        return values.to_numpy(), values.null_count() == 0

    def text(self, n: int) -> list[str | None]:
        """Return the texts of a column; None if the line is too short or the cell is empty."""
        contents: list[str | None] = self._frame[str(n)].to_list()
        return contents

    def seconds(
        self, n: int, forms: Sequence[str], origin: int | None
    ) -> tuple[Array, bool, int | None]:
        """Return the wall-clock stamps of a column.

        Parameters
        ----------
        n : int
        forms : sequence of str
            From :func:`.cells.clock_formats`; the form that reads most cells is used.
        origin : int, optional
            Reference stamp [ns]; default: the first stamp.

        Returns
        -------
        seconds : (rows,) ndarray
            Time since the origin [s], with all digits; NaN if a cell is not a stamp.
        whole : bool
            Whether all cells are stamps.
        origin : int, optional
        """
        text = self._frame[str(n)]
        dotted = text.str.strip_chars().str.replace(",", ".", literal=True)
        candidates = (_nanoseconds(dotted, form) for form in forms)
        nanoseconds = min(candidates, key=lambda stamps: stamps.null_count())
        present = nanoseconds.drop_nulls()
        if origin is None and len(present):
            origin = int(present[0])
        values = ((nanoseconds - (origin or 0)) / 1e9).to_numpy()
        return values, nanoseconds.null_count() == 0, origin


def _nanoseconds(text: pl.Series, form: str) -> pl.Series:
    """Read stamps of one form [ns], since midnight or since 1970; other texts become null."""
    if form.startswith("%H"):
        return text.str.to_time(form, strict=False).cast(pl.Int64)
    return text.str.to_datetime(form, time_unit="ns", strict=False).cast(pl.Int64)
