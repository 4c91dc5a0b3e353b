"""Rows from a stream of text: lines of CSV as a sender prints them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..logs.formats.text import TextTable
from ..logs.formats.text.cells import DELIMITERS, is_number, split
from ..logs.formats.text.parse import Ragged
from ..logs.formats.text.source import BETWEEN, interrupted
from .part import Part

#: Lines from which a log is opened: its columns are guessed from them.
HEAD_LINES = 2000
MARKS = tuple(mark.encode() for mark in BETWEEN)


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
        self._above = b""
        self._rest = b""
        self._table: TextTable | None = None

    def feed(self, data: bytes, last: bool = False) -> list[Part]:
        """Take bytes; return the rows that they complete, none before there are enough to begin, or
        the stream has ended."""
        data = self._rest + data
        if last and data and not data.endswith(b"\n"):
            data += b"\n"
        if self._table is None and (not data or (data.count(b"\n") < HEAD_LINES and not last)):
            self._rest = data
            return []
        end = data.rfind(b"\n") + 1
        self._rest = data[end:]
        block = data[:end] if self._table is not None else self._begun(data[:end])
        block = self._rows_alone(block)
        if not block:
            return []
        if block.count(b'"') % 2 == 0:
            try:
                return [self._part(block)]
            except Ragged:
                pass
        return [self._part(self._mended(block))]

    def _begun(self, data: bytes) -> bytes:
        """Find the structure of the first lines; return the rows among them."""
        lines = data.split(b"\n")[:-1]
        if self.header is None:
            lines = lines[_named_at(lines) :]
        self.head.write_bytes(b"".join([line + b"\n" for line in lines[:HEAD_LINES]]))
        names = None if self.header is None else [n.strip() for n in self.header.split(",")]
        self._table = TextTable(self.head, names)
        first = self._table.structure.first_line
        self._above = b"".join([line + b"\n" for line in lines[:first]])
        if self.header is not None:
            self._above = self.header.encode("utf-8") + b"\n"
        return b"".join([line + b"\n" for line in lines[first:]])

    def source(self, parts: Sequence[Part]) -> Path:
        """What :func:`fluxobs.read_log` opens."""
        return self.head

    def recorded(self, part: Part, first: bool) -> bytes:
        """Rows as lines of a recording, as they came; below the header, if they are the first."""
        return self._above + part.lines if first else part.lines

    def _part(self, block: bytes) -> Part:
        assert self._table is not None
        columns = self._table.parsed(block)
        if len(next(iter(columns.values()))) != block.count(b"\n"):
            raise Ragged("a quotation mark is open")
        return Part(columns, block)

    def _rows_alone(self, block: bytes) -> bytes:
        """Without blank lines, comments and a header sent again; several spaces are one."""
        assert self._table is not None
        if self._table.structure.delimiter == " ":
            block = b"".join([b" ".join(line.split()) + b"\n" for line in block.split(b"\n")[:-1]])
        head = [line.strip() for line in self._above.split(b"\n") if line.strip()]
        if not interrupted(block) and not any(line in block for line in head):
            return block
        lines = [line for line in block.split(b"\n") if line.strip() and line.strip() not in head]
        return b"".join([line + b"\n" for line in lines if not line.startswith(MARKS)])

    def _mended(self, block: bytes) -> bytes:
        """Lines that are no rows, emptied: where no column tells the time, their place counts."""
        assert self._table is not None
        structure = self._table.structure
        width, out = len(structure.names), []
        for raw in block.split(b"\n")[:-1]:
            cells = split(raw.decode("utf-8", errors="replace"), structure.delimiter)
            whole = len(cells) == width and b'"' not in raw
            self.damaged += not whole
            out.append(raw if whole else structure.delimiter.encode() * (width - 1))
        return b"\n".join(out) + b"\n"


def _named_at(lines: Sequence[bytes]) -> int:
    """Line of a header between rows: a stream that was joined on its way; else 0."""
    for n in range(1, len(lines) - 1):
        if lines[n][:1].isalpha() or lines[n][:1] == b'"':
            texts = [line.decode("utf-8", errors="replace") for line in lines[n - 1 : n + 2]]
            delimiter = next((d for d in DELIMITERS if d in texts[1]), ",")
            before, names, after = (split(text, delimiter) for text in texts)
            rows = [sum(map(is_number, cells)) for cells in (before, after)]
            if len(names) > 2 and not any(map(is_number, names)) and 2 * min(rows) > len(names):
                return n
    return 0
