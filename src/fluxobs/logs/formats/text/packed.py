"""Text as a stream: decompressed, in lines that fit into memory."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any, AnyStr, cast

from ....core.input_files import RATIO, most_unpacked
from ....errors import RecordError

#: Longest line: a log of the most columns has a hundred characters in each.
LINE = 1 << 20


class _Packed(gzip.GzipFile):
    """A compressed file; one that is cut off, damaged or a bomb ends in a RecordError."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, "rb")
        self._most = most_unpacked(path)

    def _guarded(self, method: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return method(*arguments)
        except (zlib.error, EOFError, gzip.BadGzipFile) as error:
            raise RecordError(f"{self.name}: damaged or cut off: {error}") from None

    def _content(self, method: Callable[..., Any], size: int | None) -> bytes:
        content: bytes = self._guarded(method, size)
        if self.tell() > self._most:
            raise RecordError(
                f"{self.name}: it unpacks to more than {self._most} bytes, and to more than "
                f"{RATIO} times its size: its rows repeat. If it is a log, unpack it with gunzip"
            )
        return content

    def read(self, size: int | None = -1) -> bytes:
        return self._content(super().read, size)

    def read1(self, size: int = -1) -> bytes:
        return self._content(super().read1, size)

    def readline(self, size: int | None = -1) -> bytes:
        return self._content(super().readline, size)

    def seek(self, offset: int, whence: int = 0) -> int:
        return cast(int, self._guarded(super().seek, offset, whence))


def open_packed(path: Path) -> IO[bytes]:
    """Open a compressed file for reading."""
    return cast(IO[bytes], _Packed(path))


def whole(file: IO[AnyStr], path: Path, most: int | None = None) -> Iterator[AnyStr]:
    """Lines of a file, some more than `most` characters in all.

    Raises
    ------
    RecordError
        One is longer than memory may be.
    """
    size = 0
    while (most is None or size <= most) and (line := file.readline(LINE)):
        if len(line) == LINE:
            raise RecordError(f"{path}: a line has more than {LINE} characters; this is no log")
        size += len(line)
        yield line
