"""The folder of a result: one run at a time works in it, and its files are whole or not there."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import polars as pl

from ...errors import FluxobsError
from ..locks import lock
from ..symlinks import open_own, refuse_link

#: Ending of files that are being written.
UNFINISHED = ".unfinished"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder for this process; what a killed run left unfinished is removed.

    Raises
    ------
    FluxobsError
        Another process works in it, it cannot be written, or a link in it leads elsewhere.
    """
    with os.fdopen(open_own(folder / ".lock"), "wb") as handle:
        if not lock(handle.fileno()):
            raise FluxobsError(
                f"{folder}: another run works in this folder; wait for its end, or stop it"
            )
        _tidy(folder)
        yield


def _tidy(folder: Path) -> None:
    """Remove what a killed run left unfinished; refuse links to folders, through which results
    would be written and removed elsewhere."""
    for place, folders, files in os.walk(folder):
        for name in folders:
            refuse_link(Path(place, name))
        for name in files:
            if name.startswith(".") and name.endswith(UNFINISHED):
                Path(place, name).unlink(missing_ok=True)


def write_part(frame: pl.DataFrame, path: Path) -> None:
    """Write a Parquet file that is whole or not there, whatever happens meanwhile.

    Raises
    ------
    FluxobsError
        It cannot be written: no room, no permission.
    """
    unfinished = path.with_name(f".{path.name}.{uuid.uuid4().hex}{UNFINISHED}")
    try:
        with unfinished.open("wb") as handle:
            frame.write_parquet(handle, compression="zstd", compression_level=1, statistics=False)
            handle.flush()
            os.fsync(handle.fileno())
        unfinished.replace(path)
    except (OSError, pl.exceptions.PolarsError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise FluxobsError(f"{path}: cannot be written: {reason}") from None
    finally:
        unfinished.unlink(missing_ok=True)
