"""A folder of results for one run at a time, with files that are complete or absent."""

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
    """Lock a folder for this process, and remove the unfinished files of a killed run.

    Raises
    ------
    FluxobsError
        Another process uses the folder, or the folder cannot be written or contains a link.
    """
    with os.fdopen(open_own(folder / ".lock"), "wb") as handle:
        if not lock(handle.fileno()):
            raise FluxobsError(
                f"{folder}: another run uses this folder; wait until the run ends, or stop the run"
            )
        _tidy(folder)
        yield


def _tidy(folder: Path) -> None:
    """Remove unfinished files of a killed run; refuse links to folders.

    Through such a link, the run would write and remove files elsewhere.
    """
    for root, folders, files in os.walk(folder):
        for name in folders:
            refuse_link(Path(root, name))
        for name in files:
            if name.startswith(".") and name.endswith(UNFINISHED):
                Path(root, name).unlink(missing_ok=True)


def write_part(frame: pl.DataFrame, path: Path) -> None:
    """Write a Parquet file, complete or not at all.

    Raises
    ------
    FluxobsError
        The file cannot be written (disk full, no permission).
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
