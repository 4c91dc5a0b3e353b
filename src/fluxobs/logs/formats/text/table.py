"""Tables in delimited text with any delimiter, any preamble, and decimal points or commas."""

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
from .structure import Structure, find_structure


class TextTable(Table):
    """Columns of a delimited text file.

    Parameters
    ----------
    path : Path
        A path that ends in .gz is decompressed.
    header : list of str, optional
        Names of the columns, for a file without names, or to replace the file's names.
    """

    def __init__(self, path: Path, header: list[str] | None = None) -> None:
        self.path = path
        try:
            self._open(header)
        except OSError as error:
            reason = error.strerror or str(error)
            raise RecordError(f"{path}: cannot be read: {reason}") from None

    def _open(self, header: list[str] | None) -> None:
        self._encoding = source.encoding_of(self.path)
        lines = source.first_lines(self.path, self._encoding)
        further = source.further_lines(self.path, self._encoding)
        structure = find_structure(lines, further, str(self.path), header)
        self.structure = structure
        self._index = {name: n for n, name in enumerate(structure.names) if name is not None}
        self.columns = list(self._index)
        self._clocks = self._find_clocks(lines)
        #: First stamp of each clock [ns]. Seconds since the first stamp keep all digits.
        self._origins: dict[str, int] = {}
        notes = []
        repeated = self._repeated_header(structure)
        if repeated:
            notes.append("the header is repeated further down; the repeated lines are left out")
        spaces = structure.delimiter == " " and any(
            line != " ".join(line.split()) for line in lines[structure.first_line :]
        )
        self._copy: source.Copy | None = None
        minus = any(MINUS in line for line in [*lines[structure.first_line :], *further])
        if repeated or spaces or minus or self._encoding.startswith("utf-16"):
            self._copy = source.Copy(
                self.path, self._encoding, structure.first_line, spaces, repeated
            )
        self._checked_length = False
        self._find_blocks()
        if self._copy is None and self._interrupted:
            self._copy = source.Copy(
                self.path, self._encoding, structure.first_line, spaces, repeated
            )
            self._find_blocks()
        encoding = self._encoding if self._copy is None else "utf-8"
        last_line, blank = source.last_line(self._text, encoding)
        last_cells = split(last_line, structure.delimiter)
        self.rows = max(0, self.rows - blank)
        if self.rows and last_cells != [] and len(last_cells) < len(self._header_cells()):
            self.rows -= 1
            notes.append(
                f"the last line is cut off after {len(last_cells)} of "
                f"{len(self._header_cells())} cells; this line is left out"
            )
        self.said = replace(structure.said, notes=tuple(notes))

    def _header_cells(self) -> list[str]:
        """Return the names of the columns up to the last column that is read."""
        names = self.structure.names
        last = max((n for n, name in enumerate(names) if name is not None), default=-1)
        return [name or "" for name in names[: last + 1]]

    def _repeated_header(self, structure: Structure) -> frozenset[str]:
        """Return the lines of the header if they are repeated between the rows."""
        if not structure.above or not source.repeats(self.path, structure.above[0], self._encoding):
            return frozenset()
        return frozenset(structure.above)

    def _find_clocks(self, lines: list[str]) -> dict[str, tuple[str, ...]]:
        """Map each column of wall-clock stamps to the formats that may read the stamps."""
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
        """Count the rows, and store the position of each block of rows in the file."""
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
        self._fits_memory = at < source.KEPT and numbers < source.KEPT_NUMBERS

    def _blocks(self, first: int, last: int) -> Iterator[tuple[int, bytes]]:
        """Yield (number of the first row, block) for each block that contains some of the rows."""
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
        if not self._fits_memory:
            yield from self._read(names, first, last, size)
            return
        wanted = [name for name in dict.fromkeys(names) if name not in self._kept]
        if wanted:
            if any(name in self._expected for name in wanted):
                more = [name for name in self._expected if name not in self._kept]
                wanted = list(dict.fromkeys([*wanted, *more]))
            batches = list(self._read(wanted, 0, self.rows, size))
            empty = [np.empty(0)]
            self._kept |= {
                name: np.concatenate([batch[name] for batch in batches] or empty) for name in wanted
            }
        for start in range(first, last, size):
            stop = min(start + size, last)
            yield {name: self._kept[name][start:stop] for name in names}

    def _read(self, names: Sequence[str], first: int, last: int, size: int) -> Iterator[Columns]:
        clocks = [self._index[name] for name in names if name in self._clocks]
        numbers = [self._index[name] for name in names if name not in self._clocks]
        surplus = not self.structure.said.sample_time  # instruments may end rows with delimiters
        rest: Columns = {}
        for block_start, block in self._blocks(first, last):
            try:
                parsed = Cells.of(block, self.structure, numbers, clocks)
            except Ragged as error:
                raise self._ragged_error(str(error)) from None
            if parsed.rows != block.count(b"\n") + (not block.endswith(b"\n")):
                lines = enumerate(block.split(b"\n"))
                unclosed = next((n for n, line in lines if line.count(b'"') % 2), 0)
                raise RecordError(
                    f"{self.path}, {self.place(block_start + unclosed)}: a quotation mark "
                    f"is not closed in its line. Close or remove the mark"
                )
            lower, upper = max(first - block_start, 0), min(last - block_start, parsed.rows)
            parsed = parsed.between(lower, upper)
            if surplus and parsed.surplus:
                raise self._ragged_error("lines of different length")
            columns = {}
            for name in names:
                columns[name], complete = self._column(parsed, name)
                if not complete:
                    self._check_text(name, block, block_start, lower, upper)
            if rest:
                columns = {n: np.concatenate([rest[n], v]) for n, v in columns.items()}
            rows = len(next(iter(columns.values())))
            full = rows // size * size
            for start in range(0, full, size):
                yield {n: v[start : start + size] for n, v in columns.items()}
            rest = {n: v[full:] for n, v in columns.items()} if full < rows else {}
        if rest:
            yield rest

    def parsed(self, block: bytes) -> Columns:
        """Parse all columns of further lines from a stream; NaN where a cell is not a number.

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
        """Return (numbers, whether all cells are numbers); the numbers of a clock are seconds."""
        n = self._index[name]
        if name not in self._clocks:
            return parsed.number(n)
        values, complete, origin = parsed.seconds(n, self._clocks[name], self._origins.get(name))
        if origin is not None:
            self._origins[name] = origin
        return values, complete

    def place(self, row: int) -> str:
        """Return the place of a row in the file, for a message."""
        copy = self._copy
        return f"line {1 + (self.structure.first_line + row if copy is None else copy.line(row))}"

    def _check_text(
        self, name: str, block: bytes, block_start: int, lower: int, upper: int
    ) -> None:
        """Raise RecordError if a cell of a column is neither a number nor empty."""
        n = self._index[name]
        texts = Cells.of(block, self.structure, [], [n]).text(n)
        for row in range(lower, upper):
            text = texts[row]
            if text is None and not self._checked_length:
                self._checked_length = True
                self._check_length(block.split(b"\n")[row], block_start + row)
            if text is None or is_missing(text):
                continue
            number = text.strip().replace(",", ".") if self.structure.decimal_comma else text
            try:
                float(number)
            except ValueError:
                raise RecordError(
                    f"{self.path}, {self.place(block_start + row)}, column {name!r}: {text!r} is "
                    f"not a number. Correct the cell, or leave it empty if the value is missing"
                ) from None

    def _check_length(self, line: bytes, row: int) -> None:
        """Raise RecordError if a line has too few cells."""
        text = line.decode("utf-8", errors="replace")
        cells, width = len(split(text, self.structure.delimiter)), len(self._header_cells())
        if cells < width:
            raise RecordError(
                f"{self.path}, {self.place(row)}: {cells} cells, but the header has {width}. "
                f"Complete or remove the line"
            )

    def _ragged_error(self, reason: str) -> RecordError:
        """Return an error that names the first line with too many cells; the parser names none."""
        width, first = len(self.structure.names), self.structure.first_line
        with source.open_bytes(self.path) as file:
            for number, raw in enumerate(file):
                if number >= first:
                    line = raw.decode("utf-8", errors="replace")
                    cells = len(split(line, self.structure.delimiter))
                    if cells > width:
                        return RecordError(
                            f"{self.path}, line {number + 1}: {cells} cells, but the header has "
                            f"{width}"
                        )
        return RecordError(f"{self.path}: cannot be read: {reason}")
