"""Compressed text as a stream of lines, each short enough for memory."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any, AnyStr, cast

from ....core.input_files import RATIO, most_unpacked
from ....errors import RecordError

#: Longest line [characters]: a log with the most columns may have a hundred characters per column.
LINE = 1 << 20


class _Packed(gzip.GzipFile):
    """Compressed file; raise RecordError if it is truncated, damaged or a decompression bomb."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, "rb")
        self._limit = most_unpacked(path)

    def _call_guarded(self, method: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return method(*arguments)
        except (zlib.error, EOFError, gzip.BadGzipFile) as error:
            raise RecordError(f"{self.name}: damaged or truncated: {error}") from None

    def _read_limited(self, method: Callable[..., Any], size: int | None) -> bytes:
        content: bytes = self._call_guarded(method, size)
        if self.tell() > self._limit:
            raise RecordError(
                f"{self.name}: the file unpacks to more than {self._limit} bytes, and to more than "
                f"{RATIO} times its size: the rows repeat. If the file is a log, unpack it with "
                f"gunzip"
            )
        return content

    def read(self, size: int | None = -1) -> bytes:
        return self._read_limited(super().read, size)

    def read1(self, size: int = -1) -> bytes:
        return self._read_limited(super().read1, size)

    def readline(self, size: int | None = -1) -> bytes:
        return self._read_limited(super().readline, size)

    def seek(self, offset: int, whence: int = 0) -> int:
        return cast(int, self._call_guarded(super().seek, offset, whence))


def open_packed(path: Path) -> IO[bytes]:
    """Open a compressed file for reading."""
    return cast(IO[bytes], _Packed(path))


def whole(file: IO[AnyStr], path: Path, most: int | None = None) -> Iterator[AnyStr]:
    """Yield lines of a file until the lines together exceed `most` characters.

    Raises
    ------
    RecordError
        A line is too long.
    """
    size = 0
    while (most is None or size <= most) and (line := file.readline(LINE)):
        if len(line) == LINE:
            raise RecordError(f"{path}: a line has more than {LINE} characters; this is not a log")
        size += len(line)
        yield line
