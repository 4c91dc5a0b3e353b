"""First lines of a stream: find the names, drop damaged lines."""

from __future__ import annotations

from collections.abc import Sequence

from ..logs.formats.text.cells import is_number, split
from ..logs.formats.text.source import BETWEEN
from ..logs.formats.text.structure import is_alike, kinds_of, row_kind

#: Control characters, which come from a truncated or disturbed line.
_CONTROL = "".join([chr(code) for code in range(32) if chr(code) not in "\t\r"])


def names_at(lines: Sequence[bytes], named: bool) -> int | None:
    """Return the line at which to begin, among the first lines of a stream.

    This is line 0 if names or a preamble are above the rows, or if the columns are `named` already.
    Otherwise it is the first line with names, since a sender may repeat the names; without such a
    line, return None.
    """
    texts = [_text(line) for line in lines]
    delimiter, usual = row_kind(texts, [])
    rows = [is_alike(kinds_of(text, delimiter), usual) for text in texts]
    if named or not any(rows):
        return 0
    above = rows.index(True)
    if any(_may_be_names(text, delimiter) for text in texts[:above]):
        return 0
    for n in range(above, len(texts)):
        if not rows[n] and _is_names(texts[n], delimiter, len(usual)):
            return n
    return None


def whole(lines: Sequence[bytes]) -> tuple[list[bytes], int]:
    """Return the first lines without malformed rows, and the number of malformed rows.

    Names, units and the lines above the names are kept.
    """
    texts = [_text(line) for line in lines]
    delimiter, usual = row_kind(texts, [])
    width = len(usual)
    rows = [is_alike(kinds_of(text, delimiter), usual) for text in texts]
    if not any(rows):
        return list(lines), 0
    above = rows.index(True)
    named = [n for n in range(above) if _is_names(texts[n], delimiter, width)]
    intact, damaged = [], 0
    for n, line in enumerate(lines):
        if n < above:
            clean = texts[n] != "" and not set(texts[n]) & set(_CONTROL)
            keep = clean and (not named or n <= named[0] or _is_width(texts[n], delimiter, width))
        else:
            keep = rows[n]
        if keep:
            intact.append(line)
        elif texts[n].strip() and not texts[n].startswith(BETWEEN):
            damaged += not (n > above and named and texts[n].strip() == texts[named[0]].strip())
    return intact, damaged


def _text(line: bytes) -> str:
    return line.decode("utf-8", errors="replace").rstrip("\r")


def _may_be_names(text: str, delimiter: str) -> bool:
    """Whether a line above the rows may be a header or preamble and not a truncated row."""
    cells = [cell for cell in split(text, delimiter) if cell]
    numbers = sum(map(is_number, cells))
    return len(cells) > 0 and 2 * numbers < len(cells) and not set(text) & set(_CONTROL)


def _is_width(text: str, delimiter: str, width: int) -> bool:
    return len(split(text, delimiter)) == width or text.startswith(BETWEEN)


def _is_names(text: str, delimiter: str, width: int) -> bool:
    """Whether a line has a name for each column."""
    cells = split(text, delimiter)
    named = [cell for cell in cells if cell[:1].isalpha() or cell[:1] == "_"]
    return len(cells) == width and len(named) == width
