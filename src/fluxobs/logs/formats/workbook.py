"""Check the size of a workbook before reading: a reader allocates all cells up to the last cell."""

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

#: Largest number of cells of all sheets together, up to the last row and column with content. The
#: longest Excel sheet with 32 columns has this many cells, and needs a gigabyte.
CELLS = 1 << 25
#: Largest unpacked size of a workbook [bytes]: the size of CELLS cells of numbers.
BYTES = 1 << 30
_CHUNK = 1 << 20
#: Elements of an Excel cell with content; other cells are blank.
_CONTENT = ("v", "f", "is")
_UNREADABLE = (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, ValueError)


def unpacked_size(path: Path) -> int:
    """Return the unpacked size [bytes] of an .xlsx or .ods file; refuse too large files."""
    try:
        with zipfile.ZipFile(path) as book:
            size = sum(part.file_size for part in book.infolist())
    except _UNREADABLE as error:
        raise _unreadable(path, error) from None
    limit = min(BYTES, most_unpacked(path))
    if size > limit:
        raise _too_large(path, f"{size} bytes", limit)
    return size


def check_cells(path: Path) -> None:
    """Raise RecordError if the cells of an .xlsx or .ods file do not fit into memory."""
    extent: Callable[[], _Extent] = _OpenExtent if path.suffix.lower() == ".ods" else _Extent
    try:
        with zipfile.ZipFile(path) as book:
            cells = sum(_count_cells(book, part, extent()) for part in book.infolist())
    except (*_UNREADABLE, expat.ExpatError) as error:
        raise _unreadable(path, error) from None
    if cells > CELLS:
        raise _too_large(path, f"{cells} cells up to the last cell with content", CELLS)


def _unreadable(path: Path, error: Exception) -> RecordError:
    return RecordError(f"{path}: not a readable workbook: {error}")


def _too_large(path: Path, size: str, limit: int) -> RecordError:
    return RecordError(
        f"{path}: the workbook has {size}, more than {limit}. Remove the cells outside the table, "
        f"or save the sheet as CSV"
    )


def _count_cells(book: zipfile.ZipFile, part: zipfile.ZipInfo, extent: _Extent) -> int:
    """Count the cells of a part of a workbook; a part with any name may be a sheet."""
    with book.open(part) as file:
        if not _contains(file, extent.mark):
            return 0
    parser = expat.ParserCreate()
    parser.StartElementHandler = extent.start
    parser.StartDoctypeDeclHandler = _refuse_doctype
    with book.open(part) as file:
        parser.ParseFile(file)
    return extent.cells()


def _contains(file: IO[bytes], mark: bytes) -> bool:
    previous = b""
    while chunk := file.read(_CHUNK):
        if mark in previous + chunk:
            return True
        previous = chunk[-len(mark) :]
    return False


def _refuse_doctype(*_: Any) -> None:
    raise ValueError("a sheet must not have a document type")


@lru_cache(20_000)
def _column_number(letters: str) -> int:
    """Return the number of a column from its letters."""
    number = 0
    for letter in letters.upper():
        number = 26 * number + ord(letter) - ord("A") + 1
    return number


class _Extent:
    """Last row and column with content of an Excel sheet.

    Attributes
    ----------
    mark : bytes
        Text that every sheet contains.
    """

    mark = b"sheetData"

    def __init__(self) -> None:
        self.row = self.column = 0  # position of the parser
        self.rows = self.columns = 0

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        """Process the start of an XML element."""
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
        self.row, self.column = int(reference[len(letters) :]), _column_number(letters)

    def cells(self) -> int:
        """Return the number of cells up to the last row and column."""
        return self.rows * self.columns


class _OpenExtent(_Extent):
    """Last rows and columns with content in an OpenDocument, with repeated rows and cells."""

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
