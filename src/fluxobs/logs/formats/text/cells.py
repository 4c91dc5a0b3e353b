"""Split lines of text into cells, and recognise numbers, missing values and clock times."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator

#: Cell contents that mean a missing value.
MISSING = ("", "nan", "na", "n/a", "null", "none", "-", "--", "inf", "-inf", "∞", "-∞", "#n/a")
#: Delimiters, with the most distinctive delimiter first.
DELIMITERS = ("\t", ";", "|", ",", " ")
#: Typographic minus sign.
MINUS = "\u2212"
_DECIMAL_COMMA = re.compile(rf"^\s*[-+{MINUS}]?\d+,\d+([eE][-+{MINUS}]?\d+)?\s*$")
_NUMBER = re.compile(rf"^\s*[-+{MINUS}]?(\d+(\.\d*)?|\.\d+)([eE][-+{MINUS}]?\d+)?\s*$")
#: A number with commas that may separate thousands.
_THOUSANDS = re.compile(r"^\s*[-+]?[1-9]\d{0,2}(,\d{3})+\s*$")
#: Patterns of wall-clock stamps, and the formats that read the stamps.
CLOCKS: tuple[tuple[re.Pattern[str], tuple[str, ...]], ...] = tuple(
    (re.compile(pattern), formats)
    for pattern, formats in (
        (r"^\d{4}-\d\d-\d\d[ T]\d\d:\d\d:\d\d([.,]\d+)?$", ("%Y-%m-%d{}%H:%M:%S%.f",)),
        (r"^\d{4}/\d\d/\d\d[ T]\d\d:\d\d:\d\d([.,]\d+)?$", ("%Y/%m/%d{}%H:%M:%S%.f",)),
        (r"^\d{4}-\d\d-\d\d[ T]\d\d:\d\d:\d\d([.,]\d+)?(Z|[+-]\d\d:?\d\d)$", ("%+",)),
        (r"^\d\d?\.\d\d?\.\d{4}[ T]\d\d:\d\d:\d\d([.,]\d+)?$", ("%d.%m.%Y{}%H:%M:%S%.f",)),
        (
            r"^\d\d?/\d\d?/\d{4}[ T]\d\d:\d\d:\d\d([.,]\d+)?$",
            ("%d/%m/%Y{}%H:%M:%S%.f", "%m/%d/%Y{}%H:%M:%S%.f"),
        ),
        (r"^\d\d?-[A-Za-z]{3}-\d\d[ T]\d\d:\d\d:\d\d([.,]\d+)?$", ("%d-%b-%y{}%H:%M:%S%.f",)),
        (r"^\d\d?-[A-Za-z]{3}-\d{4}[ T]\d\d:\d\d:\d\d([.,]\d+)?$", ("%d-%b-%Y{}%H:%M:%S%.f",)),
        (r"^\d\d?:\d\d:\d\d([.,]\d+)?$", ("%H:%M:%S%.f",)),
    )
)


def split(line: str, delimiter: str) -> list[str]:
    """Split a line into cells; quotes protect delimiters, and several spaces are one delimiter."""
    line = line.rstrip("\r\n")
    if delimiter == " ":
        return line.split() if '"' not in line else _split_quoted(" ".join(line.split()), " ")
    return _split_quoted(line, delimiter)


def _csv_reader(line: str, delimiter: str) -> Iterator[list[str]]:
    return csv.reader([line], delimiter=delimiter, skipinitialspace=delimiter != " ")


def _split_quoted(line: str, delimiter: str) -> list[str]:
    try:
        return [cell.strip() for cell in next(_csv_reader(line, delimiter), [])]
    except csv.Error:  # the line is not part of a table
        return [cell.strip() for cell in line.split(delimiter)]


def has_decimal_comma(cell: str) -> bool:
    """Return whether a cell is a number with a decimal comma."""
    return _DECIMAL_COMMA.match(cell) is not None


def has_thousands(cell: str) -> bool:
    """Return whether a cell is a number with commas that may separate thousands."""
    return _THOUSANDS.match(cell) is not None


def is_number(cell: str) -> bool:
    """Return whether a cell is a number, with decimal point or comma."""
    return _NUMBER.match(cell) is not None or has_decimal_comma(cell)


def is_missing(cell: str) -> bool:
    """Return whether a cell means a missing value."""
    return cell.strip().lower() in MISSING


def clock_formats(cell: str) -> tuple[str, ...]:
    """Return the wall-clock formats that may read a cell, or none if the cell is not a stamp."""
    text = cell.strip()
    for pattern, formats in CLOCKS:
        if pattern.match(text):
            return tuple(template.format("T" if "T" in text else " ") for template in formats)
    return ()
