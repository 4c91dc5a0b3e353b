"""A table in delimited text: any delimiter, decimal point or comma, any preamble."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from ....core.arrays import Array
from ....errors import RecordError
from ..table import BATCH, Columns, Table
from . import source
from .cells import MINUS, clock_formats, is_missing, split
from .parse import Cells, Ragged
from .structure import Structure, find


class TextTable(Table):
    """Columns of a delimited text file.

    Parameters
    ----------
    path : Path
        Compressed, if it ends in .gz.
    header : list of str, optional
        Names of the columns, for a file without or instead of its own.
    """

    def __init__(self, path: Path, header: list[str] | None = None) -> None:
        self.path = path
        try:
            self._open(header)
        except OSError as error:
            words = error.strerror or str(error)
            raise RecordError(f"{path}: cannot be read: {words}") from None

    def _open(self, header: list[str] | None) -> None:
        self._encoding = source.encoding_of(self.path)
        lines = source.first_lines(self.path, self._encoding)
        further = source.further_lines(self.path, self._encoding)
        found = find(lines, further, str(self.path), header)
        self.structure = found
        self._index = {name: n for n, name in enumerate(found.names) if name is not None}
        self.columns = list(self._index)
        self._clocks = self._find_clocks(lines)
        #: First stamp of each of them [ns]: seconds since then keep their digits.
        self._origins: dict[str, int] = {}
        notes = []
        drop = self._repeated(found)
        if drop:
            notes.append("the header stands again further down; these lines are left out")
        spaces = found.delimiter == " " and any(
            line != " ".join(line.split()) for line in lines[found.first_line :]
        )
        self._copy: source.Copy | None = None
        minus = any(MINUS in line for line in [*lines[found.first_line :], *further])
        if drop or spaces or minus or self._encoding.startswith("utf-16"):
            self._copy = source.Copy(self.path, self._encoding, found.first_line, spaces, drop)
        self._checked_length = False
        self._find_blocks()
        if self._copy is None and self._interrupted:
            self._copy = source.Copy(self.path, self._encoding, found.first_line, spaces, drop)
            self._find_blocks()
        encoding = self._encoding if self._copy is None else "utf-8"
        end, blank = source.last_line(self._text, encoding)
        last = split(end, found.delimiter)
        self.rows = max(0, self.rows - blank)
        if self.rows and last != [] and len(last) < len(self._filled()):
            self.rows -= 1
            notes.append(
                f"the last line is cut off after {len(last)} of {len(self._filled())} cells; it is "
                f"left out"
            )
        self.said = replace(found.said, notes=tuple(notes))

    def _filled(self) -> list[str]:
        """Columns up to the last one that is read."""
        names = self.structure.names
        last = max((n for n, name in enumerate(names) if name is not None), default=-1)
        return [name or "" for name in names[: last + 1]]

    def _repeated(self, found: Structure) -> frozenset[str]:
        """Lines of the header, if they stand again below it."""
        if not found.above or not source.repeats(self.path, found.above[0], self._encoding):
            return frozenset()
        return frozenset(found.above)

    def _find_clocks(self, lines: list[str]) -> dict[str, tuple[str, ...]]:
        """Columns of wall-clock stamps → formats that may read them."""
        for line in lines[self.structure.first_line :]:
            cells = split(line, self.structure.delimiter)
            if len(cells) >= len(self.columns):
                return {
                    name: formats
                    for name, n in self._index.items()
                    if n < len(cells) and (formats := clock_formats(cells[n]))
                }
        return {}

    def _find_blocks(self) -> None:
        """Count the rows, and note where in the file every block of them begins."""
        self._text = self.path if self._copy is None else self._copy.path
        self.random_access = not source.is_packed(self._text)
        self._kept: Columns = {}
        self._expected: list[str] = []
        skip = 0 if self._copy is not None else self.structure.first_line
        at = 0
        if skip:
            with source.open_bytes(self._text) as file:
                at = sum(len(line) for line in islice(file, skip))
        self._starts, self._firsts, self.rows = [at], [0], 0
        self._interrupted = False
        for block in source.blocks(self._text, at):
            self.rows += block.count(b"\n") + (not block.endswith(b"\n"))
            self._interrupted = self._interrupted or source.interrupted(block)
            at += len(block)
            self._starts.append(at)
            self._firsts.append(self.rows)
        numbers = 8 * self.rows * len(self.columns)
        self._small = at < source.KEPT and numbers < source.KEPT_NUMBERS

    def _blocks(self, first: int, last: int) -> Iterator[tuple[int, bytes]]:
        """Blocks that hold these rows, each with the number of its first row."""
        n = bisect_right(self._firsts, first) - 1 if self.random_access else 0
        for block in source.blocks(self._text, self._starts[n]):
            if self._firsts[n] >= last:
                return
            if self._firsts[n + 1] > first:
                yield self._firsts[n], block
            n += 1

    def expect(self, names: Sequence[str]) -> None:
        self._expected = list(names)

    def batches(
        self, names: Sequence[str], first: int, last: int, size: int = BATCH
    ) -> Iterator[Columns]:
        if not self._small:
            yield from self._read(names, first, last, size)
            return
        wanted = [name for name in dict.fromkeys(names) if name not in self._kept]
        if wanted:
            if any(name in self._expected for name in wanted):
                more = [name for name in self._expected if name not in self._kept]
                wanted = list(dict.fromkeys([*wanted, *more]))
            parts = list(self._read(wanted, 0, self.rows, size))
            none = [np.empty(0)]
            self._kept |= {n: np.concatenate([p[n] for p in parts] or none) for n in wanted}
        for start in range(first, last, size):
            stop = min(start + size, last)
            yield {name: self._kept[name][start:stop] for name in names}

    def _read(self, names: Sequence[str], first: int, last: int, size: int) -> Iterator[Columns]:
        clocks = [self._index[name] for name in names if name in self._clocks]
        numbers = [self._index[name] for name in names if name not in self._clocks]
        surplus = not self.structure.said.sample_time  # rows of instruments may end in delimiters
        left: Columns = {}
        for at, block in self._blocks(first, last):
            try:
                parsed = Cells.of(block, self.structure, numbers, clocks)
            except Ragged as error:
                raise self._ragged(str(error)) from None
            if parsed.rows != block.count(b"\n") + (not block.endswith(b"\n")):
                lines = enumerate(block.split(b"\n"))
                open_ = next((n for n, line in lines if line.count(b'"') % 2), 0)
                raise RecordError(
                    f"{self.path}, {self.place(at + open_)}: a quotation mark is not closed in "
                    f"its line. Close or remove it"
                )
            low, high = max(first - at, 0), min(last - at, parsed.rows)
            parsed = parsed.between(low, high)
            if surplus and parsed.surplus:
                raise self._ragged("lines of different length")
            found = {}
            for name in names:
                found[name], whole = self._column(parsed, name)
                if not whole:
                    self._refuse_text(name, block, at, low, high)
            if left:
                found = {n: np.concatenate([left[n], v]) for n, v in found.items()}
            rows = len(next(iter(found.values())))
            whole_parts = rows // size * size
            for cut in range(0, whole_parts, size):
                yield {n: v[cut : cut + size] for n, v in found.items()}
            left = {n: v[whole_parts:] for n, v in found.items()} if whole_parts < rows else {}
        if left:
            yield left

    def parsed(self, block: bytes) -> Columns:
        """All columns of further lines, as a stream brings them; NaN where a cell is no number.

        Raises
        ------
        Ragged
            A line has too many cells.
        """
        numbers = [n for name, n in self._index.items() if name not in self._clocks]
        clocks = [self._index[name] for name in self._clocks]
        parsed = Cells.of(block, self.structure, numbers, clocks)
        if parsed.surplus and not self.structure.said.sample_time:
            raise Ragged("lines of different length")
        return {name: self._column(parsed, name)[0] for name in self.columns}

    def _column(self, parsed: Cells, name: str) -> tuple[Array, bool]:
        """Numbers of a column, of a clock its seconds, and whether every cell has one."""
        n = self._index[name]
        if name not in self._clocks:
            return parsed.number(n)
        values, whole, origin = parsed.seconds(n, self._clocks[name], self._origins.get(name))
        if origin is not None:
            self._origins[name] = origin
        return values, whole

    def place(self, row: int) -> str:
        """Where a person finds that row in the file."""
        copy = self._copy
        return f"line {1 + (self.structure.first_line + row if copy is None else copy.line(row))}"

    def _refuse_text(self, name: str, block: bytes, at: int, low: int, high: int) -> None:
        """A cell that did not parse is either empty or a mistake."""
        n = self._index[name]
        texts = Cells.of(block, self.structure, [], [n]).text(n)
        for row in range(low, high):
            text = texts[row]
            if text is None and not self._checked_length:
                self._checked_length = True
                self._refuse_short(block.split(b"\n")[row], at + row)
            if text is None or is_missing(text):
                continue
            number = text.strip().replace(",", ".") if self.structure.decimal_comma else text
            try:
                float(number)
            except ValueError:
                raise RecordError(
                    f"{self.path}, {self.place(at + row)}, column {name!r}: {text!r} is not a "
                    f"number. Correct it, or leave the cell empty if the value is missing"
                ) from None

    def _refuse_short(self, line: bytes, row: int) -> None:
        """A missing cell is either empty, or its line is too short."""
        text = line.decode("utf-8", errors="replace")
        cells, width = len(split(text, self.structure.delimiter)), len(self._filled())
        if cells < width:
            raise RecordError(
                f"{self.path}, {self.place(row)}: {cells} cells, the header has {width}. Complete "
                f"the line or remove it"
            )

    def _ragged(self, reason: str) -> RecordError:
        """Find the first line with too many cells, to say more than the parser does."""
        width, first = len(self.structure.names), self.structure.first_line
        with source.open_bytes(self.path) as file:
            for number, raw in enumerate(file):
                if number >= first:
                    line = raw.decode("utf-8", errors="replace")
                    cells = len(split(line, self.structure.delimiter))
                    if cells > width:
                        return RecordError(
                            f"{self.path}, line {number + 1}: {cells} cells, the header has {width}"
                        )
        return RecordError(f"{self.path}: cannot be read: {reason}")
