"""Delimited text: CSV and its relatives, any delimiter, decimal point or comma."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import polars as pl

from ...errors import RecordError
from .lazy import as_columns, frames
from .table import BATCH, Columns

#: Contents of a cell that mean a missing value.
MISSING = ("", "nan", "na", "n/a", "null", "none", "-")
_DECIMAL_COMMA = re.compile(r"^\s*[-+]?\d+,\d+([eE][-+]?\d+)?\s*$")
#: Column for cells beyond the header; lines that have them are refused.
_SURPLUS = "cells beyond the header"
_DELIMITERS = ("\t", ";", "|", ",", " ")  # most distinctive first


@dataclass(frozen=True)
class Dialect:
    """How a text file is laid out."""

    delimiter: str
    decimal_comma: bool
    header_line: int  # counted from 0; comments (#) and blank lines may stand above it
    names: tuple[str, ...]


def _split(line: str, delimiter: str) -> list[str]:
    """Cells of a line; quotes protect a delimiter."""
    cells = next(csv.reader([line.rstrip("\r\n")], delimiter=delimiter), [])
    return [cell.strip() for cell in cells]


def _probe(path: Path, lines: int = 200, places: int = 8) -> list[str]:
    """The first lines of a file, and a few complete ones from further down."""
    with path.open("rb") as file:
        found = list(islice(file, lines))
        size = file.seek(0, 2)
        for n in range(1, places):
            file.seek(size * n // places)
            file.readline()
            found += list(islice(file, 20))
    return [line.decode("utf-8-sig", errors="replace") for line in found]


def sniff(path: Path) -> Dialect:
    """Dialect from the first lines.

    Raises
    ------
    RecordError
        The file is empty, has no header, or repeats a column name.
    """
    lines = _probe(path)
    if any("\x00" in line for line in lines[:5]):
        raise RecordError(f"{path}: this is not UTF-8 text; save it as CSV, Parquet or npz")
    content = [
        (number, line)
        for number, line in enumerate(lines)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not content:
        raise RecordError(f"{path}: the file is empty; it needs a header line and rows of numbers")
    header_line, header = content[0]
    delimiter = next((d for d in _DELIMITERS if d in header.strip()), ",")
    names = _split(header, delimiter)
    cells = [cell for _, line in content[1:] for cell in _split(line, delimiter)]
    if all(_is_number(name) for name in names if name):
        raise RecordError(
            f"{path}, line {header_line + 1}: expected a header with column names, found numbers: "
            f"{header.strip()[:60]!r}. Add a line of names above"
        )
    repeated = {name for name in names if names.count(name) > 1}
    if repeated:
        raise RecordError(
            f"{path}, line {header_line + 1}: the column {sorted(repeated)[0]!r} stands twice; "
            f"column names must differ"
        )
    comma = delimiter != "," and any(_DECIMAL_COMMA.match(cell) for cell in cells)
    return Dialect(delimiter, comma, header_line, tuple(names))


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


class TextTable:
    """Columns of a delimited text file."""

    random_access = False

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self.dialect = sniff(path)
        except OSError as error:
            raise RecordError(f"{path}: cannot be read: {error.strerror}") from None
        self.columns = list(self.dialect.names)
        self._checked_length = False
        try:
            # Counting lines needs no parsing of cells.
            self.rows = int(self._scan(pl.String).select(pl.len()).collect().item())
        except pl.exceptions.NoDataError:
            self.rows = 0
        except pl.exceptions.PolarsError as error:
            raise self._ragged(error) from None

    def _scan(self, dtype: type[pl.DataType]) -> pl.LazyFrame:
        return pl.scan_csv(
            self.path,
            separator=self.dialect.delimiter,
            has_header=False,
            skip_lines=self.dialect.header_line + 1,
            schema=dict.fromkeys(self.columns, dtype) | {_SURPLUS: pl.String},
            decimal_comma=self.dialect.decimal_comma,
            ignore_errors=True,
            encoding="utf8-lossy",
            missing_columns="insert",
            glob=False,
        )

    def batches(
        self, names: Sequence[str], first: int, last: int, size: int = BATCH
    ) -> Iterator[Columns]:
        row = first
        try:
            columns = [*names, _SURPLUS]
            for batch in frames(self._scan(pl.Float64), columns, first, last, size):
                if batch[_SURPLUS].null_count() < batch.height:
                    raise self._ragged("lines of different length")
                frame = batch.drop(_SURPLUS)
                for name in frame.columns:
                    if frame[name].null_count():
                        self._refuse_text(name, row, row + frame.height)
                yield as_columns(frame)
                row += frame.height
        except pl.exceptions.PolarsError as error:
            raise self._ragged(error) from None

    def place(self, row: int) -> str:
        return f"line {self.dialect.header_line + row + 2}"

    def _refuse_text(self, name: str, first: int, last: int) -> None:
        """A cell that did not parse is either empty or a mistake."""
        cells = self._scan(pl.String).select(name).slice(first, last - first).collect()[name]
        for offset, text in enumerate(cells):
            if text is None and not self._checked_length:
                self._checked_length = True
                self._refuse_short(first + offset)
            if text is None or text.strip().lower() in MISSING:
                continue
            number = text.strip().replace(",", ".") if self.dialect.decimal_comma else text.strip()
            try:
                float(number)
            except ValueError:
                raise RecordError(
                    f"{self.path}, {self.place(first + offset)}, column {name!r}: {text!r} is not "
                    f"a number. Correct it, or leave the cell empty if the value is missing"
                ) from None

    def _refuse_short(self, row: int) -> None:
        """A missing cell is either empty, or its line is too short."""
        number = self.dialect.header_line + 1 + row
        with self.path.open(encoding="utf-8", errors="replace") as file:
            line = next(islice(file, number, None), "")
        cells, width = len(_split(line, self.dialect.delimiter)), len(self.columns)
        if cells < width:
            raise RecordError(
                f"{self.path}, {self.place(row)}: {cells} cells, the header has {width}. Complete "
                f"the line or remove it"
            )

    def _ragged(self, error: object) -> RecordError:
        """Find the first line with too many cells, to say more than the parser does."""
        width = len(self.columns)
        with self.path.open(encoding="utf-8", errors="replace") as file:
            for number, line in enumerate(file):
                if number > self.dialect.header_line:
                    cells = len(_split(line, self.dialect.delimiter))
                    if cells > width:
                        return RecordError(
                            f"{self.path}, line {number + 1}: {cells} cells, the header has {width}"
                        )
        return RecordError(f"{self.path}: cannot be read: {error}")
