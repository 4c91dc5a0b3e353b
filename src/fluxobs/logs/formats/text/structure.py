"""Find the table in a text file, and the header and preamble above the table.

Rows of a table are alike: they have equally many cells, with numbers in the same columns. Later
rows define the pattern of a row; the first line with this pattern is the first row. The names are
directly above the first row, or above a row of units. Above the names is a preamble, which is
searched for the sample rate. The search does not use the names of instruments, except for an old
oscilloscope whose preamble is beside the data.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from itertools import pairwise

from ....errors import RecordError
from ...meaning.names import key, read_name
from ...meaning.units import known
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

#: First characters of header lines and comments.
COMMENT = ("#", "%", "//", "!", "'")
NUMBER, EMPTY, CLOCK, TEXT = "nect"
#: Number of lines examined to find the pattern of a row.
SAMPLE = 80
#: Largest number of columns; the widest logs have a few hundred columns.
MOST_COLUMNS = 10_000

#: First cells of header rows: of units, of names, of labels, and of other rows above the data.
_UNIT_ROW = ("yunitlabel", "unit", "units", "verticalunits", "vertunits", "vunit", "yunit")
_NAME_ROW = ("tracename", "tracenames", "signal", "signals", "name", "names", "channelname")
_LABEL_ROW = ("label", "labels")
_OTHER_ROW = ("hunit", "hoffset", "hresolution", "unitoffset", "unitscalefactor", "time")
#: Lines that separate the header from the rows.
_MARKS = ("data", "waveformdata", "timetags", "endofheader")
#: Cells of metadata below the names, such as "Unit: V".
_METADATA = re.compile(r"^(Type|Unit|Interp|BlockPath|PortIndex|Enum)\s*:\s*(.*)$")
#: Channel names that an instrument assigns; labels from its user replace these names.
_NUMBERED_NAME = re.compile(r"^(CH|C|Channel )\s?\d+$", re.IGNORECASE)
#: Header cells without a column below them.
_NO_COLUMN = ("comment", "start", "increment")
_FILLERS = frozenset(("sequence", "sample", "index", "number", "none", "unitless"))


@dataclass(frozen=True)
class Structure:
    """Structure of a text file.

    Attributes
    ----------
    delimiter : str
    decimal_comma : bool
    names : tuple of (str or None)
        One name per cell; None if the cell is not read.
    first_line : int
        Line number of the first row, from 0.
    above : tuple of str
        Lines of names and units, as written.
    said : Said
    """

    delimiter: str
    decimal_comma: bool
    names: tuple[str | None, ...]
    first_line: int
    above: tuple[str, ...]
    said: Said


def find_structure(
    lines: list[str], further: list[str], where: str, header: list[str] | None
) -> Structure:
    """Find the structure of a file from its first lines and some later lines.

    Parameters
    ----------
    lines, further : list of str
    where : str
        The file, for messages.
    header : list of str, optional
        Names of the columns, if the user gives them.

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
            f"{where}: a row has {len(kinds)} cells, more than {MOST_COLUMNS}; keep only the "
            f"columns that are needed"
        )
    if not kinds.strip(EMPTY) and len(lines) > SAMPLE:
        raise RecordError(
            f"{where}: no rows of numbers are found in its first {len(lines)} lines. Is this a "
            f"log? If the preamble is longer, remove the preamble"
        )
    first_row = _first_row(lines, delimiter, kinds)
    content = [line for line in [*lines[first_row:], *further] if line.strip()]
    with_comma = [
        cell for line in content for cell in split(line, delimiter) if has_decimal_comma(cell)
    ]
    decimal_comma = bool(with_comma)
    if delimiter == "," and decimal_comma and all(map(has_thousands, with_comma)):
        raise RecordError(
            f"{where}: {with_comma[0]!r}: does the comma separate thousands or decimals? Remove "
            f"thousands separators; with decimal commas, separate columns by semicolons"
        )
    if _has_preamble_beside(lines, delimiter):
        return _read_preamble_beside(lines, delimiter, decimal_comma)
    heading = _Header(lines, first_row, delimiter, kinds)
    names = list(header) if header is not None else heading.names(where)
    clocks = [n for n, kind in enumerate(kinds) if kind == CLOCK]
    used_names = [
        None
        if n < len(kinds) and kinds[n] == EMPTY and not _may_hold_values(name, heading)
        else name
        for n, name in enumerate(names)
    ]
    if header is None:
        _check_repeated(used_names, where, heading.names_line)
    units = heading.units(names)
    time = next((names[n] for n in clocks if n < len(names)), None)
    said = Said(
        {name: unit for name, unit in units.items() if name in used_names},
        time if time in used_names else None,
        heading.sample_time,
        heading.start or 0.0,
    )
    return Structure(delimiter, decimal_comma, tuple(used_names), first_row, heading.written, said)


def _may_hold_values(name: str, heading: _Header) -> bool:
    """Return whether an empty column is kept: its values may begin later if no rate is stated."""
    return bool(name) and heading.sample_time is None


def row_kind(lines: list[str], further: list[str]) -> tuple[str, str]:
    """Return (delimiter, kinds): the delimiter of the rows and the kind of each cell of a row."""
    sample = [line for line in lines if line.strip()]
    sample = [*sample[len(sample) // 2 :], *(line for line in further if line.strip())][-SAMPLE:]
    best: tuple[float, int, str, str] = (0.0, 0, ",", "")
    for delimiter in DELIMITERS:
        rows = [kinds_of(line, delimiter) for line in sample]
        rows = [row for row in rows if _is_row(row)]
        if not rows:
            continue
        width, count = Counter(map(len, rows)).most_common(1)[0]
        similar = [row for row in rows if len(row) == width]
        kinds = "".join(_usual_kind(column) for column in zip(*similar, strict=True))
        # rows with several cells are stronger evidence than rows with one cell
        rating = (count / len(sample) * (1.0 if width > 1 else 0.5), width, delimiter, kinds)
        if rating[:2] > best[:2]:
            best = rating
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
    """Return whether at least half of the filled cells are numbers or clock times."""
    full = len(kinds) - kinds.count(EMPTY)
    return full > 0 and 2 * (kinds.count(NUMBER) + kinds.count(CLOCK)) >= full and NUMBER in kinds


def _usual_kind(column: tuple[str, ...]) -> str:
    """Return the most frequent kind among the cells of a column that are not empty."""
    full = [kind for kind in column if kind != EMPTY]
    return Counter(full).most_common(1)[0][0] if full else EMPTY


def is_alike(kinds: str, usual: str) -> bool:
    """Return whether a line is a row: each cell is of the usual kind or empty."""
    if len(kinds) != len(usual) or not _is_row(kinds):
        return False
    if usual.startswith(EMPTY) and kinds.startswith(TEXT):  # a key
        return False
    return all(k in (EMPTY, u) or u == EMPTY for k, u in zip(kinds, usual, strict=True))


def _first_row(lines: list[str], delimiter: str, usual: str) -> int:
    """Return the index of the first row after which another row follows."""
    content = [n for n, line in enumerate(lines) if line.strip()]

    def kinds(at: int) -> str:
        return kinds_of(lines[content[at]], delimiter)

    for at in range(len(content)):
        following = min(at + 1, len(content) - 1)
        if not (is_alike(kinds(at), usual) and is_alike(kinds(following), usual)):
            continue
        while at > 0 and _with_a_mistake(kinds(at - 1), usual):
            at -= 1
        return content[at]
    return next((n + 1 for n, line in enumerate(lines) if _is_content(line)), len(lines))


def _with_a_mistake(kinds: str, usual: str) -> bool:
    """Return whether a line is a row except for a few cells."""
    mostly = 2 * kinds.count(NUMBER) > len(usual)
    return len(kinds) == len(usual) and mostly and kinds[0] == usual[0]


def _is_content(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith(COMMENT)


def _bare(line: str) -> str:
    """Return a line without a comment sign at its start."""
    text = line.rstrip("\r\n")
    stripped = text.lstrip()
    sign = next((sign for sign in COMMENT if stripped.startswith(sign)), None)
    return text if sign is None else stripped.lstrip(sign).strip()


class _Header:
    """Names, units and preamble above the rows."""

    def __init__(self, lines: list[str], first: int, delimiter: str, kinds: str):
        self.lines, self.first, self.delimiter = lines, first, delimiter
        self.kinds, self.width = kinds, max(len(kinds), 1)
        above = [n for n in range(first) if lines[n].strip()]
        while above and self._is_mark(above[-1]):
            above.pop()
        below = []
        while above and all(_METADATA.match(cell) for cell in self._cells(above[-1]) if cell):
            below.append(above.pop())
        self.units_line = self.names_line = -1
        if above and self._is_units(self._cells(above[-1])):
            self.units_line = above.pop()
        self.keyed = self._find_keyed_row(above, _NAME_ROW)
        if above and self._is_names(self._cells(above[-1])):
            cells = self._cells(above[-1])
            keys = (*_UNIT_ROW, *_OTHER_ROW, *(_NAME_ROW if len(cells) > self.width else ()))
            if key(cells[0]) not in keys or not self.keyed:
                self.names_line = above.pop()
                self.keyed = None
        self.preamble, self._metadata_rows = above, below
        self.sample_time, self.start = self._timing()
        header = (n for n in (self.names_line, self.units_line) if n >= 0)
        self.written = tuple(lines[n].rstrip("\r\n") for n in header)

    def _is_mark(self, line: int) -> bool:
        cells = [cell for cell in self._cells(line) if cell]
        return not cells or (len(cells) == 1 and key(cells[0]) in _MARKS)

    def _cells(self, line: int) -> list[str]:
        """Split a header line like the rows, or by another delimiter that fits better."""
        bare = _bare(self.lines[line])
        cells = split(bare, self.delimiter)
        if len(cells) == self.width or (len(cells) > self.width and self.delimiter != " "):
            return cells
        for pattern in (r"\t+", r" {2,}", ",", ";"):
            other = [cell.strip() for cell in re.split(pattern, bare.strip())]
            if len(other) == self.width:
                return other
        return cells

    def _find_keyed_row(self, above: list[int], keys: tuple[str, ...]) -> list[str] | None:
        """Return one cell per column from the last preamble row that begins with a key."""
        for n in reversed(above):
            cells = self._cells(n)
            if key(cells[0]) not in keys or sum(bool(cell) for cell in cells) < 2:
                continue
            while len(cells) > self.width and not cells[-1]:
                cells.pop()
            if len(cells) == self.width + 1:
                return cells[1:]
            if len(cells) == self.width:
                # the key is above an empty cell, or above the common time column
                return ["" if self.kinds[:1] == EMPTY else "Time [ms]", *cells[1:]]
        return None

    def _is_units(self, cells: list[str]) -> bool:
        units = [cell for cell in cells if known(cell)]
        others = [cell for cell in cells if cell and not known(cell)]
        fillers = all(
            is_number(cell) or key(cell) in _FILLERS or cell in ("-", "1", "[]") for cell in others
        )
        return bool(units) and fillers and len(cells) >= self.width - 1

    def _is_names(self, cells: list[str]) -> bool:
        if len(cells) < self.width and not (self.width - len(cells) == 1 and self.width > 2):
            return False
        leading = cells[: self.width]
        numbers = sum(is_number(cell) for cell in leading if cell)
        return not is_number(leading[0]) if self.units_line >= 0 else numbers == 0 and any(leading)

    def names(self, where: str) -> list[str]:
        """Return the names of the columns; raise RecordError if there are none."""
        if self.keyed is not None:
            return [cell or f"column {n + 1}" for n, cell in enumerate(self.keyed)]
        if self.names_line < 0:
            self._refuse_longer_row(where)
            row = self.lines[self.first].strip() if self.first < len(self.lines) else ""
            raise RecordError(
                f"{where}, line {self.first + 1}: expected a header with column names, found "
                f'numbers: {row[:60]!r}. Name the columns with --header "t,u_a,…", or add a '
                f"line of names above"
            )
        cells = self._cells(self.names_line)
        surplus = cells[self.width :]
        if any(cell and "=" not in cell and key(cell) not in _NO_COLUMN for cell in surplus):
            # rows that are too short are reported during reading
            return cells
        cells = cells[: self.width] + [""] * (self.width - len(cells))
        labels = self._labels()
        return [
            labels.get(n, cell) if _NUMBERED_NAME.match(cell) else cell or f"column {n + 1}"
            for n, cell in enumerate(cells)
        ]

    def _refuse_longer_row(self, where: str) -> None:
        """Raise RecordError if the line above the rows is one of them, with other cells."""
        n = self.first - 1
        if n < 1 or n >= len(self.lines):
            return
        cells = self._cells(n)
        if len(cells) > 1 and all(is_number(cell) for cell in cells if cell):
            raise RecordError(
                f"{where}, line {n + 1}: it has {len(cells)} cells, the lines below have "
                f"{self.width}. Correct or remove it"
            )

    def _labels(self) -> dict[int, str]:
        """Return column → label, from the labels that the user of an instrument has set."""
        for n in self.preamble:
            cells = self._cells(n)
            if key(cells[0]) in _LABEL_ROW:
                return {column: cell for column, cell in enumerate(cells) if column and cell}
        return {}

    def units(self, names: list[str]) -> dict[str, str]:
        """Return column → unit, from a row of units or a line of the preamble."""
        cells: list[str] = []
        for n in self._metadata_rows:
            matches = [_METADATA.match(cell) for cell in self._cells(n)]
            if any(match and match[1] == "Unit" for match in matches):
                cells = [match[2] if match else "" for match in matches]
        if not cells and self.units_line >= 0:
            cells = self._cells(self.units_line)
        elif not cells:
            cells = self._find_keyed_row(self.preamble, _UNIT_ROW) or []
            if cells[:1] == ["Time [ms]"]:
                cells[0] = ""
        return {name: cell for name, cell in zip(names, cells, strict=False) if known(cell)}

    def _timing(self) -> tuple[float | None, float | None]:
        """Return (sample time, start) from the preamble."""
        interval = start = None
        commas_split = self.delimiter == ","
        pairs = [pair for n in self.preamble for pair in _pairs(self.lines[n], commas_split)]
        if self.names_line >= 0:
            pairs += _pairs(self.lines[self.names_line], commas_split)
            if self.units_line >= 0:  # "Start, Increment" may be above numbers in the row of units
                cells = zip(
                    self._cells(self.names_line), self._cells(self.units_line), strict=False
                )
                pairs += [(name, value) for name, value in cells if is_number(value)]
        for name, value in pairs:
            reduced = key(re.sub(r"\([^()]*\)", "", name))
            if reduced in INTERVAL and interval is None:
                interval = interval_from(value, name)
            elif reduced in RATE and interval is None:
                rate = rate_from(value, name)
                interval = 1 / rate if rate else None
            elif reduced in START and start is None:
                start = seconds_from(value, name)
        return interval, start


def _pairs(line: str, commas_split: bool) -> list[tuple[str, str]]:
    """Split a preamble line, for example "a=1", "a: 1", "a,1" or "a<tab>1", into name and value."""
    marks = r"[\t;,]|\s=\s|=|:\s?" if commas_split else r"[\t;]|\s=\s|=|:\s?"
    items = [item.strip().strip('"') for item in re.split(marks, _bare(line))]
    return list(pairwise(item for item in items if item))


def _check_repeated(names: list[str | None], where: str, line: int) -> None:
    """Add the column number to repeated names; raise RecordError if a channel's name repeats."""
    seen: set[str | None] = set()
    for n, name in enumerate(names):
        if name is None or name not in seen:
            seen.add(name)
            continue
        if read_name(name).channel in (None, "t"):
            names[n] = f"{name} (column {n + 1})"
            continue
        raise RecordError(
            f"{where}, line {line + 1}: the column {name!r} occurs twice; column names must differ"
        )


def _has_preamble_beside(lines: list[str], delimiter: str) -> bool:
    """Return whether the preamble is to the left of the data, as in files of old oscilloscopes."""
    cells = split(lines[0], delimiter)
    return len(cells) >= 5 and key(cells[0]) == "recordlength" and all(map(is_number, cells[3:5]))


def _read_preamble_beside(lines: list[str], delimiter: str, comma: bool) -> Structure:
    pairs = {key(cells[0]): cells[1] for line in lines[:20] if (cells := split(line, delimiter))[0]}
    name = pairs.get("source", "CH1")
    unit, seconds = pairs.get("verticalunits", ""), pairs.get("horizontalunits", "s")
    units = {"TIME": seconds} | ({name: unit} if known(unit) else {})
    width = len(split(lines[0], delimiter))
    names = (None, None, None, "TIME", name, *[None] * (width - 5))
    return Structure(delimiter, comma, names, 0, (), Said(units, "TIME"))
