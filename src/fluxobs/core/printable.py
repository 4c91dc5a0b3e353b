"""Make texts from outside, such as names of files and columns, safe to display."""

from __future__ import annotations

#: Control characters, which command a terminal, except line ends and tabs.
_CONTROLS = {n: f"\\x{n:02x}" for n in (*range(32), *range(127, 160)) if chr(n) not in "\n\t"}
#: Surrogates, which cannot be encoded or drawn. Python's surrogateescape replaces bytes of a file
#: name that are not UTF-8 by surrogates.
_SURROGATES = {n: f"\\u{n:04x}" for n in range(0xD800, 0xE000)}
_BYTES = {0xDC00 + n: f"\\x{n:02x}" for n in range(0x80, 0x100)}
_SHOWN = _CONTROLS | _SURROGATES | _BYTES


def visible(text: str) -> str:
    r"""Return the text with control characters and surrogates replaced by visible codes.

    Examples
    --------
    >>> print(visible("\x1b[31mcaf\udce9.csv"))
    \x1b[31mcaf\xe9.csv
    """
    return text.translate(_SHOWN)
