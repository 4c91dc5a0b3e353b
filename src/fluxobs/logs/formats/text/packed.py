"""Text that is compressed by gzip."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any, cast

from ....errors import RecordError


class _Packed(gzip.GzipFile):
    """A compressed file; one that is cut off or damaged ends in a RecordError."""

    def _guarded(self, method: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return method(*arguments)
        except (zlib.error, EOFError, gzip.BadGzipFile) as error:
            raise RecordError(f"{self.name}: damaged or cut off: {error}") from None

    def read(self, size: int | None = -1) -> bytes:
        return cast(bytes, self._guarded(super().read, size))

    def read1(self, size: int = -1) -> bytes:
        return cast(bytes, self._guarded(super().read1, size))

    def readline(self, size: int | None = -1) -> bytes:
        return cast(bytes, self._guarded(super().readline, size))

    def seek(self, offset: int, whence: int = 0) -> int:
        return cast(int, self._guarded(super().seek, offset, whence))


def open_packed(path: Path) -> IO[bytes]:
    """Open a compressed file for reading."""
    return cast(IO[bytes], _Packed(path, "rb"))
