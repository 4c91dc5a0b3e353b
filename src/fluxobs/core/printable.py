"""Texts of others, such as the names of files and columns, where a person reads them."""

from __future__ import annotations

#: Characters that command a terminal, but for the ends of lines and tabs.
_COMMANDS = {n: f"\\x{n:02x}" for n in (*range(32), *range(127, 160)) if chr(n) not in "\n\t"}
#: Halves of characters, which no file and no font takes; those of Python's surrogateescape stand
#: for the bytes of a file name that are no UTF-8.
_HALVES = {n: f"\\u{n:04x}" for n in range(0xD800, 0xE000)}
_BYTES = {0xDC00 + n: f"\\x{n:02x}" for n in range(0x80, 0x100)}
_SHOWN = _COMMANDS | _HALVES | _BYTES


def visible(text: str) -> str:
    r"""The same without commands to a terminal, and without what is no character.

    Examples
    --------
    >>> print(visible("\x1b[31mcaf\udce9.csv"))
    \x1b[31mcaf\xe9.csv
    """
    return text.translate(_SHOWN)
