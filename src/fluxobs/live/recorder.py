"""Recording of a stream; the file has all received lines, even if the program is killed."""

from __future__ import annotations

import os
from io import FileIO
from itertools import count
from pathlib import Path
from typing import Self

from ..core.locks import lock
from ..core.symlinks import open_own
from ..errors import FluxobsError


class Recorder:
    """File of recorded lines, created or locked from the start so that no other run writes to it.

    An existing file keeps its contents until the first lines are written. A new file without lines
    is removed.

    Parameters
    ----------
    path : Path
    force : bool
        Whether an existing file may be overwritten.

    Attributes
    ----------
    written : bool
        Whether lines have been written.
    """

    def __init__(self, path: Path, force: bool = False) -> None:
        self.path, self.force = path, force
        self.written = False
        self._file: FileIO

    def __enter__(self) -> Self:
        """Open the file.

        Raises
        ------
        FluxobsError
            The file exists and `force` is not given, is a link, belongs to another run, or cannot
            be written.
        """
        if self.path.exists() and not self.path.is_file():
            raise FluxobsError(f"{self.path}: is not a regular file; give another name")
        self._created = not (self.force and os.path.lexists(self.path))
        try:
            if self._created:
                self._file = self.path.open("xb", buffering=0)
            else:
                self._file = os.fdopen(open_own(self.path), "wb", buffering=0)
        except FileExistsError:
            raise FluxobsError(
                f"{self.path}: exists; give another name, or --force to overwrite it"
            ) from None
        except OSError as error:
            raise self._write_error(error) from None
        if not lock(self._file.fileno()):
            self._file.close()
            raise FluxobsError(
                f"{self.path}: another run records into this file; give another name"
            )
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._file.close()
            if self._created and not self.written:
                self.path.unlink(missing_ok=True)
        except OSError as error:
            raise self._write_error(error) from None

    def add(self, lines: bytes) -> None:
        """Write lines to the file at once, without a buffer.

        Raises
        ------
        FluxobsError
            The file cannot be written.
        """
        try:
            if not self.written:
                self._file.truncate(0)
            self.written = True
            remaining = memoryview(lines)
            while remaining:
                remaining = remaining[self._file.write(remaining) :]
        except OSError as error:
            raise self._write_error(error) from None

    def _write_error(self, error: OSError) -> FluxobsError:
        return FluxobsError(f"{self.path}: cannot be written: {error.strerror}")


def save_raw(path: Path, data: bytes) -> Path:
    """Write bytes beside a recording, under the first free name: run.raw, run-2.raw, ….

    Raises
    ------
    FluxobsError
        The file cannot be written.
    """
    for n in count(1):
        raw = path.with_name(f"{path.stem}{f'-{n}' if n > 1 else ''}.raw")
        try:
            with raw.open("xb") as file:
                file.write(data)
            return raw
        except FileExistsError:
            continue
        except OSError as error:
            raise FluxobsError(f"{raw}: cannot be written: {error.strerror}") from None
    raise AssertionError("unreachable: count() is infinite")
