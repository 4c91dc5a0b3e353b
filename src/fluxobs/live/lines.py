"""Rows from a text stream: lines of CSV as a sender prints them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import RecordError
from ..logs.formats.text import TextTable
from ..logs.formats.text.cells import is_missing, is_number, split
from ..logs.formats.text.parse import Ragged
from ..logs.formats.text.source import BETWEEN, interrupted
from ..logs.formats.text.structure import Structure, row_kind
from . import header as first_lines
from .rows import StreamRows

if TYPE_CHECKING:
    from .reorder import Ordered

#: Lines from which a log is opened; they determine the log's columns.
HEAD_LINES = 2000
#: Every line is shorter than this [bytes].
_LONGEST = 1 << 20
MARKS = tuple(mark.encode() for mark in BETWEEN)
#: Start of a line that may hold names.
_LETTER = re.compile(rb'^["A-Za-z_]', re.MULTILINE)


class Lines:
    """Rows from a stream of lines. Delimiter and columns are detected as in a file.

    Parameters
    ----------
    head : Path
        File for the first lines, from which the log is opened.
    header : str, optional
        Names of the columns, separated by commas, if the stream sends none.

    Attributes
    ----------
    damaged : int
        Malformed lines.
    """

    def __init__(self, head: Path, header: str | None = None) -> None:
        self.head, self.header = head, header
        self.damaged = 0
        self._unnamed = 0  # lines searched without finding names
        self._returns = False  # whether lines end in \r without \n
        self._above = b""
        self._rest = b""
        self._table: TextTable | None = None
        self._numeric: list[str] = []

    @property
    def waiting(self) -> str:
        """Input that the stream still lacks before the first row, in words."""
        if self._unnamed:
            return (
                f"a line that names the columns, not found in {self._unnamed} lines; "
                f"give the names with --header NAME,NAME,…"
            )
        lines = self._rest.count(b"\n")
        return f"the stream's first {HEAD_LINES} rows" + (f", {lines} received" if lines else "")

    def feed(self, data: bytes, last: bool = False) -> list[StreamRows]:
        """Add received bytes; return the rows that they complete.

        Rows are held back until there are HEAD_LINES lines or the stream ends.

        Raises
        ------
        RecordError
            The bytes are not lines, or the columns have changed.
        """
        data = self._normalize_ends(self._rest + data, last)
        while self._table is None and data:
            lines = data.split(b"\n", HEAD_LINES)
            if len(lines) <= HEAD_LINES and not last:
                break
            data = self._begin(lines[:-1], last) + lines[-1]
        end = data.rfind(b"\n") + 1 if self._table is not None else 0
        self._rest = data[end:]
        if end == 0:
            return []
        block = self._rows_only(data[:end])
        if not block:
            return []
        if block.count(b'"') % 2 == 0:
            try:
                return [self._parse(block)]
            except Ragged:
                pass
        return [self._parse(self._blank_malformed(block))]

    def _normalize_ends(self, data: bytes, last: bool) -> bytes:
        """Return bytes whose lines end in a line feed; with `last`, also the last line."""
        if self._table is None and b"\n" not in data and data.count(b"\r") > 1:
            self._returns = True
        if self._returns:
            data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        if len(data) > _LONGEST and b"\n" not in data:
            raise RecordError(
                f"{len(data)} bytes arrived without the end of a line; send lines of CSV, each "
                f"ending in a line feed, or the frames of an export's telemetry"
            )
        return data + b"\n" if last and data and not data.endswith(b"\n") else data

    def _begin(self, lines: list[bytes], last: bool) -> bytes:
        """Detect the structure of the first lines; return the rows among them.

        If there are no names yet, or the names are below the first line, return the lines from
        which to continue.
        """
        at = first_lines.names_at(lines, self.header is not None)
        if not last and (at is None or at > 0):
            dropped = max(1, len(lines) - 2) if at is None else at
            self._unnamed = self._unnamed + dropped if at is None else 0
            return b"".join([line + b"\n" for line in lines[dropped:]])
        lines, self.damaged = first_lines.whole(lines[at or 0 :])
        self.head.write_bytes(b"".join([line + b"\n" for line in lines]))
        names = None if self.header is None else [n.strip() for n in self.header.split(",")]
        try:
            self._table = TextTable(self.head, names)
        except RecordError as error:
            raise RecordError(str(error).replace(str(self.head), "the stream")) from None
        self._unnamed = 0
        first = self._table.structure.first_line
        _, kinds = row_kind([line.decode("utf-8", errors="replace") for line in lines[first:]], [])
        columns = zip(self._table.structure.names, kinds, strict=False)
        self._numeric = [name for name, kind in columns if name is not None and kind in "ne"]
        self._above = b"".join([line + b"\n" for line in lines[:first]])
        if self.header is not None:
            self._above = self.header.encode("utf-8") + b"\n"
        return b"".join([line + b"\n" for line in lines[first:]])

    @property
    def _structure(self) -> Structure:
        assert self._table is not None
        return self._table.structure

    def sources(self, batches: Sequence[StreamRows]) -> Iterator[Path]:
        """Yield inputs for :func:`fluxobs.read_log`: all first lines, then parts of them."""
        lines = self.head.read_bytes().split(b"\n")[:-1]
        first = self._structure.first_line
        yield self.head
        for n, (begin, end) in enumerate(pieces(len(lines) - first)):
            path = self.head.parent / f"{self.head.name}-{n}"
            selected = [*lines[:first], *lines[first + begin : first + end]]
            path.write_bytes(b"".join([line + b"\n" for line in selected]))
            yield path

    def recorded(self, rows: Ordered, time: str | None, first: bool) -> bytes:
        """Return rows as lines of a recording; above the first rows, add the header.

        Lines stay as received, except where a reader of files would refuse them: cells that are not
        numbers become empty, and time continues where the sender restarted.
        """
        received, head = rows.received, self._above if first else b""
        missing = np.zeros(received.rows, dtype=bool)
        for name in self._numeric:
            missing = missing | np.isnan(received.columns[name])
        moved = rows.moved != 0 if time is not None else np.zeros(received.rows, dtype=bool)
        if not (missing | moved).any():
            return head + received.lines
        lines = received.lines.split(b"\n")[:-1]
        for k in np.flatnonzero(missing | moved):
            lines[int(k)] = self._repair_cells(lines[int(k)], time, float(rows.moved[int(k)]))
        return head + b"".join([line + b"\n" for line in lines])

    def _repair_cells(self, line: bytes, time: str | None, moved: float) -> bytes:
        structure = self._structure
        cells = split(line.decode("utf-8", errors="replace"), structure.delimiter)
        cells += [""] * (len(structure.names) - len(cells))
        for n, name in enumerate(structure.names):
            if name is None or is_missing(cells[n]):
                continue
            if name == time and moved and is_number(cells[n]):
                text = f"{float(cells[n].replace(',', '.')) + moved:.12g}"
                cells[n] = text.replace(".", ",") if structure.decimal_comma else text
            elif name in self._numeric and not is_number(cells[n]):
                cells[n] = ""
        return structure.delimiter.join(cells).encode("utf-8")

    def _parse(self, block: bytes) -> StreamRows:
        assert self._table is not None
        columns = self._table.parsed(block)
        if len(next(iter(columns.values()))) != block.count(b"\n"):
            raise Ragged("a quotation mark is open")
        return StreamRows(columns, block)

    def _rows_only(self, block: bytes) -> bytes:
        """Drop blank lines, comments and repeated headers; join several spaces to one."""
        if self._structure.delimiter == " ":
            block = b"".join([b" ".join(line.split()) + b"\n" for line in block.split(b"\n")[:-1]])
        if not interrupted(block) and _LETTER.search(block) is None:
            return block
        head = [line.strip() for line in self._above.split(b"\n") if line.strip()]
        lines = [line for line in block.split(b"\n") if line.strip() and line.strip() not in head]
        for line in lines:
            if _LETTER.match(line):
                self._check_names(line)
        return b"".join([line + b"\n" for line in lines if not line.startswith(MARKS)])

    def _check_names(self, line: bytes) -> None:
        """Raise RecordError if the names in a line or their order differ from the stream's."""
        structure = self._structure
        cells = split(line.decode("utf-8", errors="replace"), structure.delimiter)
        names = [name for name in structure.names if name is not None]
        if 2 * sum(cell in names for cell in cells) >= len(cells) > 2 and cells != names:
            raise RecordError(
                f"the columns of the stream changed from {','.join(names)} to {','.join(cells)}; "
                f"start again"
            )

    def _blank_malformed(self, block: bytes) -> bytes:
        """Replace malformed lines by empty rows, since the time may be the number of rows."""
        structure = self._structure
        width, lines = len(structure.names), []
        for raw in block.split(b"\n")[:-1]:
            cells = split(raw.decode("utf-8", errors="replace"), structure.delimiter)
            fits = len(cells) == width and b'"' not in raw
            self.damaged += not fits
            lines.append(raw if fits else structure.delimiter.encode() * (width - 1))
        return b"\n".join(lines) + b"\n"


def pieces(rows: int) -> list[tuple[int, int]]:
    """Return begin and end of halves, quarters and eighths of the first rows, later parts first.

    If some of the first rows are out of order, one of these parts may still be in order.
    """
    bounds: list[tuple[int, int]] = []
    for count in (2, 4, 8):
        for k in reversed(range(count)):
            bounds.append((rows * k // count, rows * (k + 1) // count))
    return bounds
