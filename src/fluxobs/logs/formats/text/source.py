"""Bytes of a text file: encoding, head, tail, and a copy if the file cannot be read in place."""

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

#: Bytes examined at each end of a file.
END = 65536
#: Number of first lines searched for the structure of a file. The preamble of an instrument has at
#: most a hundred lines; a repeated descriptor has a few more.
HEAD_LINES = 600
#: Largest number of bytes in these lines: about ten lines of a log with the most columns.
HEAD = 1 << 22
#: First characters of comments that are between rows.
BETWEEN = ("#", "%")
#: Characters that a line without values may contain.
EMPTY = " \t\r\n,;|"
#: First bytes of compressed files → program that unpacks them.
_COMPRESSED = {
    b"\x1f\x8b": "gzip",
    b"\xfd7zXZ\x00": "xz",
    b"BZh": "bzip2",
    b"\x28\xb5\x2f\xfd": "zstd",
    b"PK\x03\x04": "zip",
}
#: Bytes parsed at once: about ten thousand rows.
BLOCK = 1 << 22
#: Columns of files below this size [bytes] are parsed once and kept: a run reads a log five times.
KEPT = 1 << 26
#: Largest size of kept columns [bytes]: as numbers, cells of one character are 8 times as large.
KEPT_NUMBERS = 1 << 28


def is_packed(path: Path) -> bool:
    """Return whether a file is compressed by gzip."""
    return path.suffix.lower() == ".gz"


def open_bytes(path: Path) -> IO[bytes]:
    """Open a file for reading, decompressed.

    Raises
    ------
    RecordError
        The compressed data are damaged; raised while reading.
    """
    return open_packed(path) if is_packed(path) else path.open("rb")


def encoding_of(path: Path) -> str:
    """Return the encoding of a text file.

    Raises
    ------
    RecordError
        The file is not text.
    """
    with open_bytes(path) as file:
        head = file.read(END)
    _refuse(path, head)
    if head.startswith(b"\xef\xbb\xbf"):
        return "utf-8-sig"
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if b"\x00" in head:
        odd, even = head[1::2].count(0), head[::2].count(0)
        if max(odd, even) < 0.4 * len(head) / 2 or min(odd, even) > 0.1 * len(head) / 2:
            raise RecordError(
                f"{path}: this is not text, and its ending, {path.suffix or 'none'}, is not a "
                f"known format. Save the log as CSV, Parquet or npz"
            )
        return "utf-16-le" if odd > even else "utf-16-be"
    try:
        head[: len(head) - 4].decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"


def _refuse(path: Path, head: bytes) -> None:
    """Raise RecordError for files that must be changed before they can be read as text."""
    for magic, program in _COMPRESSED.items():
        if head.startswith(magic):
            other = {"gzip": ", or name it .gz", "zip": ", or name a spreadsheet .xlsx"}
            raise RecordError(
                f"{path}: this is not text but compressed by {program}: unpack it"
                f"{other.get(program, '')}"
            )
    if head.startswith((b"\xff\xfe\x00\x00", b"\x00\x00\xfe\xff")):
        raise RecordError(f"{path}: this is text in UTF-32: save it as UTF-8")
    if b"\n" not in head and head.count(b"\r") > 1:
        raise RecordError(
            f"{path}: its lines end with a carriage return only: save it with line feeds"
        )


def first_lines(path: Path, encoding: str) -> list[str]:
    """Return the first lines, decoded."""
    with open_bytes(path) as file:
        if encoding.startswith("utf-16"):
            return file.read(END * 4).decode(encoding, errors="replace").splitlines()[:HEAD_LINES]
        return [_decode(line, encoding) for line in islice(whole(file, path, HEAD), HEAD_LINES)]


def further_lines(path: Path, encoding: str, places: int = 8) -> list[str]:
    """Return a few complete lines from later parts of the file, if seeking is cheap."""
    if is_packed(path) or encoding.startswith("utf-16"):
        return []
    lines: list[bytes] = []
    with path.open("rb") as file:
        size = file.seek(0, 2)
        if size < 2 * END:
            return []
        for n in range(1, places):
            file.seek(size * n // places)
            lines += list(islice(whole(file, path), 21))[1:]  # the first line is cut
    return [_decode(line, encoding) for line in lines]


def _decode(line: bytes, encoding: str) -> str:
    return line.decode(encoding, errors="replace").lstrip("\ufeff").rstrip("\r\n")


def last_line(path: Path, encoding: str) -> tuple[str, int]:
    """Return (last line with values, number of lines without values below this line).

    Return ("", 0) for compressed files, because reading up to their end is slow.
    """
    if is_packed(path):
        return "", 0
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(max(0, size - END) & ~1)
        lines = file.read().decode(encoding.removesuffix("-sig"), errors="replace").splitlines()
    blank = next((n for n, line in enumerate(reversed(lines)) if line.strip(EMPTY)), 0)
    return (lines[-1 - blank] if lines else ""), blank


def repeats(path: Path, header: str, encoding: str) -> bool:
    """Return whether a line occurs more than once in a file."""
    pattern = b"\n" + header.encode(encoding.removesuffix("-sig"), errors="replace")
    count, previous = 0, b"\n"
    with open_bytes(path) as file:
        while chunk := file.read(BLOCK):
            piece = (
                previous + chunk.removeprefix(b"\xef\xbb\xbf") if count == 0 else previous + chunk
            )
            count += piece.count(pattern)
            if count > 1:
                return True
            previous = piece[-len(pattern) + 1 :]
    return False


_SPACES = re.compile(rb"\n +\r?\n")


def interrupted(block: bytes) -> bool:
    """Return whether a block has blank lines or comments between its rows."""
    text = b"\n" + block.rstrip()
    if any(mark in text for mark in (b"\n\n", b"\n\r\n", b"\n#", b"\n%")):
        return True
    return b"\n " in text and _SPACES.search(text) is not None


def blocks(path: Path, start: int) -> Iterator[bytes]:
    """Yield blocks of whole lines from byte `start` on; a block has a few megabytes."""
    with open_bytes(path) as file:
        file.seek(start)
        while chunk := file.read(BLOCK):
            yield chunk + next(whole(file, path), b"")


class Copy:
    """Temporary copy of a file's rows as plain UTF-8 text, deleted with this object.

    Attributes
    ----------
    path : Path
    """

    def __init__(self, path: Path, encoding: str, first: int, spaces: bool, drop: frozenset[str]):
        self._source, self._encoding, self._first, self._drop = path, encoding, first, drop
        with tempfile.NamedTemporaryFile(
            "w", encoding="utf-8", suffix=".csv", prefix="fluxobs-", delete=False, newline="\n"
        ) as file:
            self.path = Path(file.name)
            self._finalizer = weakref.finalize(self, self.path.unlink, missing_ok=True)
            for _, text in self._numbered_rows():
                text = re.sub(r"\s+", " ", text.strip()) if spaces else text
                file.write(text.replace(MINUS, "-") + "\n")

    def _numbered_rows(self) -> Iterator[tuple[int, str]]:
        """Yield the rows of the file, each with its line number."""
        for number, line in enumerate(_read_lines(self._source, self._encoding)):
            text = line.rstrip("\r\n")
            if number < self._first or not text.strip(" "):
                continue
            if text not in self._drop and not text.startswith(BETWEEN):
                yield number, text

    def line(self, row: int) -> int:
        """Return the line number, from 0, that a row of the copy has in the file."""
        for n, (number, _) in enumerate(self._numbered_rows()):
            if n == row:
                return number
        return self._first + row


def _read_lines(path: Path, encoding: str) -> Iterator[str]:
    with open_bytes(path) as file:
        if encoding.startswith("utf-16"):
            with io.TextIOWrapper(file, encoding, errors="replace") as decoded:
                yield from whole(decoded, path)
        else:
            for line in whole(file, path):
                yield _decode(line, encoding)
