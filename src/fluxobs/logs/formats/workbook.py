"""How large a workbook is, before it is read: the reader allocates all cells up to the last one."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import IO, Any
from xml.parsers import expat

from ...core.input_files import most_unpacked
from ...errors import RecordError

#: Most cells of all sheets together, up to the last row and column with content: the longest sheet
#: that Excel has, with 32 columns, which takes a gigabyte.
CELLS = 1 << 25
#: Most bytes of all parts of a workbook, unpacked: so many cells of numbers have as many.
BYTES = 1 << 30
_CHUNK = 1 << 20
#: What a cell of Excel holds; others are blank.
_CONTENT = ("v", "f", "is")
_UNREADABLE = (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, ValueError)


def unpacked_size(path: Path) -> int:
    """Bytes of all parts of a workbook, .xlsx or .ods; RecordError if memory does not hold them."""
    try:
        with zipfile.ZipFile(path) as book:
            size = sum(part.file_size for part in book.infolist())
    except _UNREADABLE as error:
        raise _unreadable(path, error) from None
    most = min(BYTES, most_unpacked(path))
    if size > most:
        raise _too_large(path, f"{size} bytes", most)
    return size


def check_cells(path: Path) -> None:
    """Raise RecordError if the cells of a workbook, .xlsx or .ods, would not fit into memory."""
    extent: Callable[[], _Extent] = _OpenExtent if path.suffix.lower() == ".ods" else _Extent
    try:
        with zipfile.ZipFile(path) as book:
            cells = sum(_cells(book, part, extent()) for part in book.infolist())
    except (*_UNREADABLE, expat.ExpatError) as error:
        raise _unreadable(path, error) from None
    if cells > CELLS:
        raise _too_large(path, f"{cells} cells up to the last one with content", CELLS)


def _unreadable(path: Path, error: Exception) -> RecordError:
    return RecordError(f"{path}: not a readable workbook: {error}")


def _too_large(path: Path, what: str, most: int) -> RecordError:
    return RecordError(
        f"{path}: it has {what}, more than {most}. Remove what stands apart from the table, or "
        f"save the sheet as CSV"
    )


def _cells(book: zipfile.ZipFile, part: zipfile.ZipInfo, extent: _Extent) -> int:
    """Cells of the sheets in a part of a workbook; any part may be a sheet, whatever its name."""
    with book.open(part) as file:
        if not _has(file, extent.mark):
            return 0
    parser = expat.ParserCreate()
    parser.StartElementHandler = extent.start
    parser.StartDoctypeDeclHandler = _refuse_doctype
    with book.open(part) as file:
        parser.ParseFile(file)
    return extent.cells()


def _has(file: IO[bytes], mark: bytes) -> bool:
    before = b""
    while chunk := file.read(_CHUNK):
        if mark in before + chunk:
            return True
        before = chunk[-len(mark) :]
    return False


def _refuse_doctype(*_: Any) -> None:
    raise ValueError("a sheet has no document type")


@lru_cache(20_000)
def _number(letters: str) -> int:
    """Number of a column from its letters."""
    number = 0
    for letter in letters.upper():
        number = 26 * number + ord(letter) - ord("A") + 1
    return number


class _Extent:
    """Last row and column with content of a sheet of Excel.

    Attributes
    ----------
    mark : bytes
        What every sheet contains.
    """

    mark = b"sheetData"

    def __init__(self) -> None:
        self.row = self.column = 0  # where the parser is
        self.rows = self.columns = 0

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        """Take the beginning of an element."""
        name = tag.rpartition(":")[2]
        if name == "c":
            self._place(attributes.get("r"))
        elif name in _CONTENT:
            self.rows = max(self.rows, self.row)
            self.columns = max(self.columns, self.column)
        elif name == "row":
            self.row, self.column = int(attributes.get("r", self.row + 1)), 0

    def _place(self, reference: str | None) -> None:
        if reference is None:
            self.column += 1
            return
        letters = reference.rstrip("0123456789")
        self.row, self.column = int(reference[len(letters) :]), _number(letters)

    def cells(self) -> int:
        """Cells up to the last ones."""
        return self.rows * self.columns


class _OpenExtent(_Extent):
    """The same of the sheets of an OpenDocument, whose rows and cells are repeated by a count."""

    mark = b"table:table-row"

    def __init__(self) -> None:
        super().__init__()
        self.sheets = 0

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        if tag == "table:table":
            self.sheets += self.rows * self.columns
            self.row = self.rows = self.columns = 0
        elif tag == "table:table-row":
            self.row += int(attributes.get("table:number-rows-repeated", 1))
            self.column = 0
        elif tag in ("table:table-cell", "table:covered-table-cell"):
            self.column += int(attributes.get("table:number-columns-repeated", 1))
            if any(name.startswith("office:") for name in attributes):
                self.rows, self.columns = max(self.rows, self.row), max(self.columns, self.column)

    def cells(self) -> int:
        return self.sheets + self.rows * self.columns
