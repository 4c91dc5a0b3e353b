"""Where the table begins in a text file, and what stands above it.

Rows of a table are alike: as many cells, numbers in the same places. The rows further down show
what a row is; the first row is the first line like them. Names stand right above, perhaps with a
row of units between. What stands above the names is a preamble, in which the sample rate is looked
for. No instrument is known by name, except an old one that writes its preamble beside the data.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from itertools import pairwise

from ....errors import RecordError
from ...names import key, read_name
from ...units import known
from ..table import Said
from ..timing import INTERVAL, RATE, START, interval_from, rate_from, seconds_from
from .cells import (
    DELIMITERS,
    clock_formats,
    has_decimal_comma,
    has_thousands,
    is_missing,
    is_number,
    split,
)

#: At the head of a line that belongs to a header, or is a comment.
COMMENT = ("#", "%", "//", "!", "'")
NUMBER, EMPTY, CLOCK, TEXT = "nect"
#: Lines that are looked at to see what a row is.
SEEN = 80
#: Columns of a log; the widest has some hundred.
MOST_COLUMNS = 10_000

#: Keys in front of a row of units, or of names; and of other rows between names and data.
_UNIT_ROW = ("yunitlabel", "unit", "units", "verticalunits", "vertunits", "vunit", "yunit")
_NAME_ROW = ("tracename", "tracenames", "signal", "signals", "name", "names", "channelname")
_LABEL_ROW = ("label", "labels")
_OTHER_ROW = ("hunit", "hoffset", "hresolution", "unitoffset", "unitscalefactor", "time")
#: A line of its own between the header and the rows.
_MARKS = ("data", "waveformdata", "timetags", "endofheader")
#: Cells of metadata below the names, as "Unit: V".
_BELOW = re.compile(r"^(Type|Unit|Interp|BlockPath|PortIndex|Enum)\s*:\s*(.*)$")
#: Names that an instrument gives a channel, which its user's label replaces.
_NUMBERED = re.compile(r"^(CH|C|Channel )\s?\d+$", re.IGNORECASE)
#: Header cells that have no column below them.
_NO_COLUMN = ("comment", "start", "increment")
_FILLERS = frozenset(("sequence", "sample", "index", "number", "none", "unitless"))


@dataclass(frozen=True)
class Structure:
    """How a text file is laid out.

    Attributes
    ----------
    delimiter : str
    decimal_comma : bool
    names : tuple of (str or None)
        One a cell; None for cells that hold nothing to be read.
    first_line : int
        Line of the first row, from 0.
    above : tuple of str
        The lines of names and units, as written.
    said : Said
    """

    delimiter: str
    decimal_comma: bool
    names: tuple[str | None, ...]
    first_line: int
    above: tuple[str, ...]
    said: Said


def find(lines: list[str], further: list[str], where: str, header: list[str] | None) -> Structure:
    """Structure of a file from its first lines, and some from further down.

    Parameters
    ----------
    lines, further : list of str
    where : str
        The file, for messages.
    header : list of str, optional
        Names of the columns, where the user gives them.

    Raises
    ------
    RecordError
        The file is empty, has no header, or repeats a column name.
    """
    if not any(line.strip() for line in lines):
        raise RecordError(f"{where}: the file is empty; it needs a header line and rows of numbers")
    delimiter, kinds = row_kind(lines, further)
    if len(kinds) > MOST_COLUMNS:
        raise RecordError(
            f"{where}: a row has {len(kinds)} cells, more than {MOST_COLUMNS}; keep those needed"
        )
    if not kinds.strip(EMPTY) and len(lines) > SEEN:
        raise RecordError(
            f"{where}: no rows of numbers are found in its first {len(lines)} lines. Is this a "
            f"log? If a longer preamble stands above the rows, remove it"
        )
    first = _first_row(lines, delimiter, kinds)
    content = [line for line in [*lines[first:], *further] if line.strip()]
    with_comma = [c for line in content for c in split(line, delimiter) if has_decimal_comma(c)]
    comma = bool(with_comma)
    if delimiter == "," and comma and all(map(has_thousands, with_comma)):
        raise RecordError(
            f"{where}: {with_comma[0]!r}: does the comma part thousands, or is it a decimal comma? "
            f"Write numbers without the former; with the latter part columns by semicolons"
        )
    if _beside(lines, delimiter):
        return _tektronix(lines, delimiter, comma)
    head = _Head(lines, first, delimiter, kinds)
    names = list(header) if header is not None else head.names(where)
    clocks = [n for n, kind in enumerate(kinds) if kind == CLOCK]
    kept = [
        None if n < len(kinds) and kinds[n] == EMPTY and not _wanted(name, head) else name
        for n, name in enumerate(names)
    ]
    if header is None:
        _check_repeated(kept, where, head.names_line)
    units = head.units(names)
    time = next((names[n] for n in clocks if n < len(names)), None)
    said = Said(
        {name: unit for name, unit in units.items() if name in kept},
        time if time in kept else None,
        head.sample_time,
        head.start or 0.0,
    )
    return Structure(delimiter, comma, tuple(kept), first, head.written, said)


def _wanted(name: str, head: _Head) -> bool:
    """An empty column of a file without preamble is kept: its values may begin later."""
    return bool(name) and head.sample_time is None


def row_kind(lines: list[str], further: list[str]) -> tuple[str, str]:
    """Delimiter of the rows, and what each of their cells is."""
    sample = [line for line in lines if line.strip()]
    sample = [*sample[len(sample) // 2 :], *(line for line in further if line.strip())][-SEEN:]
    best: tuple[float, int, str, str] = (0.0, 0, ",", "")
    for delimiter in DELIMITERS:
        rows = [kinds_of(line, delimiter) for line in sample]
        rows = [row for row in rows if _is_row(row)]
        if not rows:
            continue
        width, count = Counter(map(len, rows)).most_common(1)[0]
        alike = [row for row in rows if len(row) == width]
        kinds = "".join(_usual(column) for column in zip(*alike, strict=True))
        # several cells in a row say more than one
        found = (count / len(sample) * (1.0 if width > 1 else 0.5), width, delimiter, kinds)
        if found[:2] > best[:2]:
            best = found
    if best[1]:
        return best[2], best[3]
    line = next(filter(_is_content, lines), "")
    delimiter = next((d for d in DELIMITERS if d in line.strip()), ",")
    return delimiter, EMPTY * len(split(line, delimiter))


def kinds_of(line: str, delimiter: str) -> str:
    return "".join(
        NUMBER
        if is_number(cell)
        else EMPTY
        if is_missing(cell)
        else CLOCK
        if clock_formats(cell)
        else TEXT
        for cell in split(line, delimiter)
    )


def _is_row(kinds: str) -> bool:
    """At least half of the cells are numbers."""
    full = len(kinds) - kinds.count(EMPTY)
    return full > 0 and 2 * (kinds.count(NUMBER) + kinds.count(CLOCK)) >= full and NUMBER in kinds


def _usual(column: tuple[str, ...]) -> str:
    """What a cell is in most rows where it is not empty."""
    full = [kind for kind in column if kind != EMPTY]
    return Counter(full).most_common(1)[0][0] if full else EMPTY


def is_alike(kinds: str, usual: str) -> bool:
    """Whether a line is a row: the same numbers and texts, and perhaps empty cells."""
    if len(kinds) != len(usual) or not _is_row(kinds):
        return False
    if usual.startswith(EMPTY) and kinds.startswith(TEXT):  # a key
        return False
    return all(k in (EMPTY, u) or u == EMPTY for k, u in zip(kinds, usual, strict=True))


def _first_row(lines: list[str], delimiter: str, usual: str) -> int:
    """Index of the first line that is a row, as is the next one with content."""
    content = [n for n, line in enumerate(lines) if line.strip()]

    def kinds(at: int) -> str:
        return kinds_of(lines[content[at]], delimiter)

    for at in range(len(content)):
        after = min(at + 1, len(content) - 1)
        if not (is_alike(kinds(at), usual) and is_alike(kinds(after), usual)):
            continue
        while at > 0 and _with_a_mistake(kinds(at - 1), usual):
            at -= 1
        return content[at]
    return next((n + 1 for n, line in enumerate(lines) if _is_content(line)), len(lines))


def _with_a_mistake(kinds: str, usual: str) -> bool:
    """Whether a line is a row, but for a cell or two."""
    mostly = 2 * kinds.count(NUMBER) > len(usual)
    return len(kinds) == len(usual) and mostly and kinds[0] == usual[0]


def _is_content(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith(COMMENT)


def _bare(line: str) -> str:
    """A line without the sign of a comment at its head."""
    text = line.rstrip("\r\n")
    stripped = text.lstrip()
    mark = next((mark for mark in COMMENT if stripped.startswith(mark)), None)
    return text if mark is None else stripped.lstrip(mark).strip()


class _Head:
    """What stands above the rows: names, units, preamble."""

    def __init__(self, lines: list[str], first: int, delimiter: str, kinds: str):
        self.lines, self.first, self.delimiter = lines, first, delimiter
        self.kinds, self.width = kinds, max(len(kinds), 1)
        above = [n for n in range(first) if lines[n].strip()]
        while above and self._is_mark(above[-1]):
            above.pop()
        below = []
        while above and all(_BELOW.match(c) for c in self._cells(above[-1]) if c):
            below.append(above.pop())
        self.units_line = self.names_line = -1
        if above and self._is_units(self._cells(above[-1])):
            self.units_line = above.pop()
        self.keyed = self._keyed(above, _NAME_ROW)
        if above and self._is_names(self._cells(above[-1])):
            cells = self._cells(above[-1])
            keys = (*_UNIT_ROW, *_OTHER_ROW, *(_NAME_ROW if len(cells) > self.width else ()))
            if key(cells[0]) not in keys or not self.keyed:
                self.names_line = above.pop()
                self.keyed = None
        self.preamble, self._below = above, below
        self.sample_time, self.start = self._timing()
        used = (n for n in (self.names_line, self.units_line) if n >= 0)
        self.written = tuple(lines[n].rstrip("\r\n") for n in used)

    def _is_mark(self, line: int) -> bool:
        cells = [cell for cell in self._cells(line) if cell]
        return not cells or (len(cells) == 1 and key(cells[0]) in _MARKS)

    def _cells(self, line: int) -> list[str]:
        """Cells of a header line: parted as the rows are, or otherwise if that fits better."""
        bare = _bare(self.lines[line])
        cells = split(bare, self.delimiter)
        if len(cells) == self.width or (len(cells) > self.width and self.delimiter != " "):
            return cells
        for pattern in (r"\t+", r" {2,}", ",", ";"):
            other = [cell.strip() for cell in re.split(pattern, bare.strip())]
            if len(other) == self.width:
                return other
        return cells

    def _keyed(self, above: list[int], keys: tuple[str, ...]) -> list[str] | None:
        """Cells of the last row of the preamble with such a key in front, one a column."""
        for n in reversed(above):
            cells = self._cells(n)
            if key(cells[0]) not in keys or sum(bool(cell) for cell in cells) < 2:
                continue
            while len(cells) > self.width and not cells[-1]:
                cells.pop()
            if len(cells) == self.width + 1:
                return cells[1:]
            if len(cells) == self.width:
                # beside an empty cell, or above the time of all columns
                return ["" if self.kinds[:1] == EMPTY else "Time [ms]", *cells[1:]]
        return None

    def _is_units(self, cells: list[str]) -> bool:
        units = [cell for cell in cells if known(cell)]
        others = [cell for cell in cells if cell and not known(cell)]
        fillers = all(is_number(c) or key(c) in _FILLERS or c in ("-", "1", "[]") for c in others)
        return bool(units) and fillers and len(cells) >= self.width - 1

    def _is_names(self, cells: list[str]) -> bool:
        if len(cells) < self.width and not (self.width - len(cells) == 1 and self.width > 2):
            return False
        words = cells[: self.width]
        numbers = sum(is_number(word) for word in words if word)
        return not is_number(words[0]) if self.units_line >= 0 else numbers == 0 and any(words)

    def names(self, where: str) -> list[str]:
        """Names of the columns; RecordError if there are none."""
        if self.keyed is not None:
            return [cell or f"column {n + 1}" for n, cell in enumerate(self.keyed)]
        if self.names_line < 0:
            row = self.lines[self.first].strip() if self.first < len(self.lines) else ""
            raise RecordError(
                f"{where}, line {self.first + 1}: expected a header with column names, found "
                f'numbers: {row[:60]!r}. Name them with --header "t,u_a,…", or add a line of names '
                f"above"
            )
        cells = self._cells(self.names_line)
        surplus = cells[self.width :]
        if any(cell and "=" not in cell and key(cell) not in _NO_COLUMN for cell in surplus):
            # rows that are too short are complained about when they are read
            return cells
        cells = cells[: self.width] + [""] * (self.width - len(cells))
        labels = self._labels()
        return [
            labels.get(n, cell) if _NUMBERED.match(cell) else cell or f"column {n + 1}"
            for n, cell in enumerate(cells)
        ]

    def _labels(self) -> dict[int, str]:
        """What the user of an instrument called its channels, by column."""
        for n in self.preamble:
            cells = self._cells(n)
            if key(cells[0]) in _LABEL_ROW:
                return {k: cell for k, cell in enumerate(cells) if k and cell}
        return {}

    def units(self, names: list[str]) -> dict[str, str]:
        """Column → unit, from a row of units or from a line of the preamble."""
        cells: list[str] = []
        for n in self._below:
            found = [_BELOW.match(cell) for cell in self._cells(n)]
            if any(one and one[1] == "Unit" for one in found):
                cells = [one[2] if one else "" for one in found]
        if not cells and self.units_line >= 0:
            cells = self._cells(self.units_line)
        elif not cells:
            cells = self._keyed(self.preamble, _UNIT_ROW) or []
            if cells[:1] == ["Time [ms]"]:
                cells[0] = ""
        return {name: cell for name, cell in zip(names, cells, strict=False) if known(cell)}

    def _timing(self) -> tuple[float | None, float | None]:
        """Sample time and start that a preamble says."""
        interval = start = None
        comma = self.delimiter == ","
        pairs = [pair for n in self.preamble for pair in _pairs(self.lines[n], comma)]
        if self.names_line >= 0:
            pairs += _pairs(self.lines[self.names_line], comma)
            if self.units_line >= 0:  # names "Start, Increment" over numbers in the row of units
                cells = zip(
                    self._cells(self.names_line), self._cells(self.units_line), strict=False
                )
                pairs += [(a, b) for a, b in cells if is_number(b)]
        for name, value in pairs:
            word = key(re.sub(r"\([^()]*\)", "", name))
            if word in INTERVAL and interval is None:
                interval = interval_from(value, name)
            elif word in RATE and interval is None:
                rate = rate_from(value, name)
                interval = 1 / rate if rate else None
            elif word in START and start is None:
                start = seconds_from(value, name)
        return interval, start


def _pairs(line: str, comma: bool) -> list[tuple[str, str]]:
    """Names and values of a preamble line: "a=1", "a: 1", "a,1" (if commas part), "a<tab>1"."""
    marks = r"[\t;,]|\s=\s|=|:\s?" if comma else r"[\t;]|\s=\s|=|:\s?"
    parts = [part.strip().strip('"') for part in re.split(marks, _bare(line))]
    return list(pairwise(part for part in parts if part))


def _check_repeated(names: list[str | None], where: str, line: int) -> None:
    """Names that mean a channel must differ; others, and further times, get a number."""
    seen: set[str | None] = set()
    for n, name in enumerate(names):
        if name is None or name not in seen:
            seen.add(name)
            continue
        if read_name(name).channel in (None, "t"):
            names[n] = f"{name} (column {n + 1})"
            continue
        raise RecordError(
            f"{where}, line {line + 1}: the column {name!r} stands twice; column names must differ"
        )


def _beside(lines: list[str], delimiter: str) -> bool:
    """Whether the preamble stands left of the data, as old Tektronix instruments write it."""
    cells = split(lines[0], delimiter)
    return len(cells) >= 5 and key(cells[0]) == "recordlength" and all(map(is_number, cells[3:5]))


def _tektronix(lines: list[str], delimiter: str, comma: bool) -> Structure:
    pairs = {key(cells[0]): cells[1] for line in lines[:20] if (cells := split(line, delimiter))[0]}
    name = pairs.get("source", "CH1")
    unit, seconds = pairs.get("verticalunits", ""), pairs.get("horizontalunits", "s")
    units = {"TIME": seconds} | ({name: unit} if known(unit) else {})
    width = len(split(lines[0], delimiter))
    names = (None, None, None, "TIME", name, *[None] * (width - 5))
    return Structure(delimiter, comma, names, 0, (), Said(units, "TIME"))
