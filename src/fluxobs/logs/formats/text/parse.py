"""Lines of delimited text as numbers: the work of Polars."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Self

import polars as pl

from ....core.arrays import Array
from ..lazy import BROKEN
from .structure import Structure

#: Column for cells beyond the header; lines that have them are refused.
_SURPLUS = "surplus"


class Ragged(ValueError):
    """Lines differ in length."""


class Cells:
    """Cells of some lines, by the number of their column.

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
        """Part some lines into the columns that are asked for.

        Raises
        ------
        Ragged
            A line has too many cells.
        """
        asked = {*numbers, *texts}
        schema: dict[str, type[pl.DataType]] = {
            str(n): pl.Float64 if n in numbers else pl.String for n in range(len(structure.names))
        }
        scanned = pl.scan_csv(
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
            return cls(scanned.select([*(str(n) for n in sorted(asked)), _SURPLUS]).collect())
        except BROKEN as error:
            raise Ragged(str(error).split("\n")[0]) from None

    def between(self, first: int, last: int) -> Cells:
        """Those of the lines first … last - 1."""
        return Cells(self._frame.slice(first, last - first))

    @property
    def surplus(self) -> bool:
        """Whether a line has cells with contents beyond the last column."""
        beyond = self._frame[_SURPLUS].drop_nulls()
        return bool(len(beyond) and (beyond.str.strip_chars() != "").any())

    def number(self, n: int) -> tuple[Array, bool]:
        """Numbers of a column, NaN where a cell has none; whether all cells have one."""
        values = self._frame[str(n)]
        return values.to_numpy(), values.null_count() == 0

    def text(self, n: int) -> list[str | None]:
        """Contents of a column; None where a line is too short, or the cell empty."""
        found: list[str | None] = self._frame[str(n)].to_list()
        return found

    def seconds(
        self, n: int, forms: Sequence[str], origin: int | None
    ) -> tuple[Array, bool, int | None]:
        """Wall-clock stamps of a column.

        Parameters
        ----------
        n : int
        forms : sequence of str
            Of which the one is taken that reads most, from :func:`.cells.clock_formats`.
        origin : int, optional
            A stamp [ns]; default: the first one.

        Returns
        -------
        seconds : (rows,) ndarray
            Since the origin [s], with all their digits; NaN where there is none.
        whole : bool
            Whether all cells have one.
        origin : int, optional
        """
        text = self._frame[str(n)]
        dotted = text.str.strip_chars().str.replace(",", ".", literal=True)
        read = (_nanoseconds(dotted, form) for form in forms)
        found = min(read, key=lambda one: one.null_count())
        known = found.drop_nulls()
        if origin is None and len(known):
            origin = int(known[0])
        values = ((found - (origin or 0)) / 1e9).to_numpy()
        return values, found.null_count() == 0, origin


def _nanoseconds(text: pl.Series, form: str) -> pl.Series:
    """Stamps of one form, since midnight or since 1970; null where they are of another."""
    if form.startswith("%H"):
        return text.str.to_time(form, strict=False).cast(pl.Int64)
    return text.str.to_datetime(form, time_unit="ns", strict=False).cast(pl.Int64)
