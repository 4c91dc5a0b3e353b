"""The bytes of a text file: encoding, ends, and a copy where it cannot be read in place."""

from __future__ import annotations

import io
import re
import tempfile
import weakref
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import IO

from ....errors import RecordError
from .cells import MINUS
from .packed import open_packed, whole

#: Bytes at either end that are looked at.
END = 65536
#: First lines of a file in which its structure is looked for; an instrument's preamble has a
#: hundred lines at most, a repeated descriptor some more.
HEAD_LINES = 600
#: Bytes of them: a log of the most columns has some ten lines in these.
HEAD = 1 << 22
#: What lines between rows begin with, that are none.
BETWEEN = ("#", "%")
#: What a line holds that has no values.
EMPTY = " \t\r\n,;|"
#: Bytes that are parsed at once: some ten thousand rows.
BLOCK = 1 << 22
#: Columns of a smaller file are parsed once, and kept: a run reads a log five times.
KEPT = 1 << 26
#: Most bytes of these columns: cells of one character are eight times as large as numbers.
KEPT_NUMBERS = 1 << 28


def is_packed(path: Path) -> bool:
    """Whether a file is compressed by gzip."""
    return path.suffix.lower() == ".gz"


def open_bytes(path: Path) -> IO[bytes]:
    """Open a file for reading, decompressed.

    Raises
    ------
    RecordError
        While it is read: its compressed bytes are damaged.
    """
    return open_packed(path) if is_packed(path) else path.open("rb")


def encoding_of(path: Path) -> str:
    """Encoding of a text file.

    Raises
    ------
    RecordError
        It is no text.
    """
    with open_bytes(path) as file:
        head = file.read(END)
    if head.startswith(b"\xef\xbb\xbf"):
        return "utf-8-sig"
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if b"\x00" in head:
        odd, even = head[1::2].count(0), head[::2].count(0)
        if max(odd, even) < 0.4 * len(head) / 2 or min(odd, even) > 0.1 * len(head) / 2:
            raise RecordError(
                f"{path}: this is not text, and its ending, {path.suffix or 'none'}, is not that "
                f"of a known format. Save it as CSV, Parquet or npz"
            )
        return "utf-16-le" if odd > even else "utf-16-be"
    try:
        head[: len(head) - 4].decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"


def first_lines(path: Path, encoding: str) -> list[str]:
    """The first lines, decoded."""
    with open_bytes(path) as file:
        if encoding.startswith("utf-16"):
            return file.read(END * 4).decode(encoding, errors="replace").splitlines()[:HEAD_LINES]
        return [_decoded(line, encoding) for line in islice(whole(file, path, HEAD), HEAD_LINES)]


def further_lines(path: Path, encoding: str, places: int = 8) -> list[str]:
    """A few complete lines from further down, where that costs nothing."""
    if is_packed(path) or encoding.startswith("utf-16"):
        return []
    found: list[bytes] = []
    with path.open("rb") as file:
        size = file.seek(0, 2)
        if size < 2 * END:
            return []
        for n in range(1, places):
            file.seek(size * n // places)
            found += list(islice(whole(file, path), 21))[1:]  # the first of them is cut
    return [_decoded(line, encoding) for line in found]


def _decoded(line: bytes, encoding: str) -> str:
    return line.decode(encoding, errors="replace").lstrip("\ufeff").rstrip("\r\n")


def last_line(path: Path, encoding: str) -> tuple[str, int]:
    """The last line with content, and the lines below it that are blank or but delimiters; nothing
    is known of a file whose end costs reading all of it."""
    if is_packed(path):
        return "", 0
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(max(0, size - END) & ~1)
        lines = file.read().decode(encoding.removesuffix("-sig"), errors="replace").splitlines()
    blank = next((n for n, line in enumerate(reversed(lines)) if line.strip(EMPTY)), 0)
    return (lines[-1 - blank] if lines else ""), blank


def repeats(path: Path, header: str, encoding: str) -> bool:
    """Whether a line stands more than once in a file."""
    wanted = b"\n" + header.encode(encoding.removesuffix("-sig"), errors="replace")
    count, before = 0, b"\n"
    with open_bytes(path) as file:
        while chunk := file.read(BLOCK):
            piece = before + chunk.removeprefix(b"\xef\xbb\xbf") if count == 0 else before + chunk
            count += piece.count(wanted)
            if count > 1:
                return True
            before = piece[-len(wanted) + 1 :]
    return False


_SPACES = re.compile(rb"\n +\r?\n")


def interrupted(block: bytes) -> bool:
    """Whether there are blank lines or comments between the rows of a block."""
    found = b"\n" + block.rstrip()
    if any(mark in found for mark in (b"\n\n", b"\n\r\n", b"\n#", b"\n%")):
        return True
    return b"\n " in found and _SPACES.search(found) is not None


def blocks(path: Path, start: int) -> Iterator[bytes]:
    """Whole lines of a file from a byte on, some megabytes at once."""
    with open_bytes(path) as file:
        file.seek(start)
        while chunk := file.read(BLOCK):
            yield chunk + next(whole(file, path), b"")


class Copy:
    """A copy of a file's rows in plain UTF-8 text, which lives as long as this object.

    Attributes
    ----------
    path : Path
    """

    def __init__(self, path: Path, encoding: str, first: int, spaces: bool, drop: frozenset[str]):
        self._source, self._encoding, self._first, self._drop = path, encoding, first, drop
        with tempfile.NamedTemporaryFile(
            "w", encoding="utf-8", suffix=".csv", prefix="fluxobs-", delete=False, newline="\n"
        ) as out:
            self.path = Path(out.name)
            self._end = weakref.finalize(self, self.path.unlink, missing_ok=True)
            for _, text in self._rows():
                text = re.sub(r"\s+", " ", text.strip()) if spaces else text
                out.write(text.replace(MINUS, "-") + "\n")

    def _rows(self) -> Iterator[tuple[int, str]]:
        """Rows of the file, each with the number of its line."""
        for number, line in enumerate(_lines(self._source, self._encoding)):
            text = line.rstrip("\r\n")
            if number < self._first or not text.strip(" "):
                continue
            if text not in self._drop and not text.startswith(BETWEEN):
                yield number, text

    def line(self, row: int) -> int:
        """Line of the file, from 0, in which a row of the copy stands."""
        for n, (number, _) in enumerate(self._rows()):
            if n == row:
                return number
        return self._first + row


def _lines(path: Path, encoding: str) -> Iterator[str]:
    with open_bytes(path) as file:
        if encoding.startswith("utf-16"):
            with io.TextIOWrapper(file, encoding, errors="replace") as decoded:
                yield from whole(decoded, path)
        else:
            for line in whole(file, path):
                yield _decoded(line, encoding)
