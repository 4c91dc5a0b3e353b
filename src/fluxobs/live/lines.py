"""Rows from a stream of text: lines of CSV as a sender prints them."""

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

#: Lines from which a log is opened: its columns are guessed from them.
HEAD_LINES = 2000
#: A line is shorter [bytes].
_LONGEST = 1 << 20
MARKS = tuple(mark.encode() for mark in BETWEEN)
#: A line that may hold names.
_LETTER = re.compile(rb'^["A-Za-z_]', re.MULTILINE)


class Lines:
    """Rows from a stream of lines; how they are parted is found as in a file.

    Parameters
    ----------
    head : Path
        Where the first lines are kept, for the reader of files.
    header : str, optional
        Names of the columns, parted by commas, if the stream has none.

    Attributes
    ----------
    damaged : int
        Lines that were no rows.
    """

    def __init__(self, head: Path, header: str | None = None) -> None:
        self.head, self.header = head, header
        self.damaged = 0
        self._passed = 0  # lines in which no names were found
        self._returns = False  # whether lines end in \r alone
        self._above = b""
        self._rest = b""
        self._table: TextTable | None = None
        self._numeric: list[str] = []

    @property
    def waiting(self) -> str:
        """What is to come before there are rows."""
        if self._passed:
            return (
                f"a line that names the columns; there is none among {self._passed} lines. "
                f"--header NAME,NAME,… gives them"
            )
        lines = self._rest.count(b"\n")
        return f"the stream's first {HEAD_LINES} rows" + (f", {lines} came" if lines else "")

    def feed(self, data: bytes, last: bool = False) -> list[StreamRows]:
        """Take bytes; return the rows that they complete, none before there are enough to begin, or
        the stream has ended.

        Raises
        ------
        RecordError
            What comes are no lines, or other columns than before.
        """
        data = self._ended(self._rest + data, last)
        while self._table is None and data:
            lines = data.split(b"\n", HEAD_LINES)
            if len(lines) <= HEAD_LINES and not last:
                break
            data = self._begun(lines[:-1], last) + lines[-1]
        end = data.rfind(b"\n") + 1 if self._table is not None else 0
        self._rest = data[end:]
        if end == 0:
            return []
        block = self._rows_alone(data[:end])
        if not block:
            return []
        if block.count(b'"') % 2 == 0:
            try:
                return [self._part(block)]
            except Ragged:
                pass
        return [self._part(self._mended(block))]

    def _ended(self, data: bytes, last: bool) -> bytes:
        """Bytes whose lines end in a line feed, the last one too if no more comes."""
        if self._table is None and b"\n" not in data and data.count(b"\r") > 1:
            self._returns = True
        if self._returns:
            data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        if len(data) > _LONGEST and b"\n" not in data:
            raise RecordError(
                f"{len(data)} bytes came without the end of a line. A stream is lines of CSV, each "
                f"with a line feed, or the frames of an export's telemetry"
            )
        return data + b"\n" if last and data and not data.endswith(b"\n") else data

    def _begun(self, lines: list[bytes], last: bool) -> bytes:
        """Find the structure of the first lines; return the rows among them. If their names are
        still to come, or stand farther down, return the lines from which to go on."""
        at = first_lines.names_at(lines, self.header is not None)
        if not last and (at is None or at > 0):
            dropped = max(1, len(lines) - 2) if at is None else at
            self._passed = self._passed + dropped if at is None else 0
            return b"".join([line + b"\n" for line in lines[dropped:]])
        lines, self.damaged = first_lines.whole(lines[at or 0 :])
        self.head.write_bytes(b"".join([line + b"\n" for line in lines]))
        names = None if self.header is None else [n.strip() for n in self.header.split(",")]
        try:
            self._table = TextTable(self.head, names)
        except RecordError as error:
            raise RecordError(str(error).replace(str(self.head), "the stream")) from None
        self._passed = 0
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

    def sources(self, parts: Sequence[StreamRows]) -> Iterator[Path]:
        """What :func:`fluxobs.read_log` may open: all first lines, or pieces of them."""
        lines = self.head.read_bytes().split(b"\n")[:-1]
        first = self._structure.first_line
        yield self.head
        for n, (begin, end) in enumerate(pieces(len(lines) - first)):
            path = self.head.parent / f"{self.head.name}-{n}"
            kept = [*lines[:first], *lines[first + begin : first + end]]
            path.write_bytes(b"".join([line + b"\n" for line in kept]))
            yield path

    def recorded(self, rows: Ordered, time: str | None, first: bool) -> bytes:
        """Rows as lines of a recording, as they came, but for what a reader of files refuses: cells
        that are no numbers are empty, and time goes on where the sender began anew. The header
        stands above the first."""
        part, head = rows.part, self._above if first else b""
        unknown = np.zeros(part.rows, dtype=bool)
        for name in self._numeric:
            unknown = unknown | np.isnan(part.columns[name])
        moved = rows.moved != 0 if time is not None else np.zeros(part.rows, dtype=bool)
        if not (unknown | moved).any():
            return head + part.lines
        lines = part.lines.split(b"\n")[:-1]
        for k in np.flatnonzero(unknown | moved):
            lines[int(k)] = self._mended_cells(lines[int(k)], time, float(rows.moved[int(k)]))
        return head + b"".join([line + b"\n" for line in lines])

    def _mended_cells(self, line: bytes, time: str | None, moved: float) -> bytes:
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

    def _part(self, block: bytes) -> StreamRows:
        assert self._table is not None
        columns = self._table.parsed(block)
        if len(next(iter(columns.values()))) != block.count(b"\n"):
            raise Ragged("a quotation mark is open")
        return StreamRows(columns, block)

    def _rows_alone(self, block: bytes) -> bytes:
        """Without blank lines, comments and a header sent again; several spaces are one."""
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
        """Raise RecordError for a line of other names than before, or the same in another order."""
        structure = self._structure
        cells = split(line.decode("utf-8", errors="replace"), structure.delimiter)
        known = [name for name in structure.names if name is not None]
        if 2 * sum(cell in known for cell in cells) >= len(cells) > 2 and cells != known:
            raise RecordError(
                f"the columns of the stream changed from {','.join(known)} to {','.join(cells)}; "
                f"begin again"
            )

    def _mended(self, block: bytes) -> bytes:
        """Lines that are no rows, emptied: where no column tells the time, their place counts."""
        structure = self._structure
        width, out = len(structure.names), []
        for raw in block.split(b"\n")[:-1]:
            cells = split(raw.decode("utf-8", errors="replace"), structure.delimiter)
            fits = len(cells) == width and b'"' not in raw
            self.damaged += not fits
            out.append(raw if fits else structure.delimiter.encode() * (width - 1))
        return b"\n".join(out) + b"\n"


def pieces(rows: int) -> list[tuple[int, int]]:
    """First and last of halves of the first rows, of quarters and eighths, the later ones first:
    where some of these came out of order, a piece may be whole."""
    out: list[tuple[int, int]] = []
    for parts in (2, 4, 8):
        for k in reversed(range(parts)):
            out.append((rows * k // parts, rows * (k + 1) // parts))
    return out
