"""A stream, recorded: what has come is in the file, whatever ends the program."""

from __future__ import annotations

from pathlib import Path
from typing import IO, Self

from ..errors import FluxobsError


class Recorder:
    """Writes lines to a file, which is made when the first ones come.

    Parameters
    ----------
    path : Path
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: IO[bytes] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            if self._file is not None:
                self._file.close()
        except OSError as error:
            raise self._failed(error) from None

    def add(self, lines: bytes) -> None:
        """Write lines; they are in the file at once.

        Raises
        ------
        FluxobsError
            The file cannot be written.
        """
        try:
            if self._file is None:
                self._file = self.path.open("wb")
            self._file.write(lines)
            self._file.flush()
        except OSError as error:
            raise self._failed(error) from None

    def _failed(self, error: OSError) -> FluxobsError:
        self._file = None
        return FluxobsError(f"{self.path}: cannot be written: {error.strerror}")
