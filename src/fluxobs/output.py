"""Files that appear complete or not at all."""

from __future__ import annotations

import os
import tempfile
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import polars as pl
from polars.io.plugins import register_io_source

from .errors import FluxobsError

Part = TypeVar("Part")
Schema = dict[str, pl.DataType | type[pl.DataType]]


def check_place(path: Path) -> None:
    """FluxobsError where no file can be: its folder is missing, or it is a folder itself."""
    if path.is_dir():
        raise FluxobsError(f"{path}: this is a folder")
    if not path.parent.is_dir():
        raise FluxobsError(f"{path}: the folder {path.parent} does not exist")


def make_folder(path: str | Path) -> Path:
    """The folder, made if it is missing; FluxobsError where it cannot be."""
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FluxobsError(f"{path}: cannot be made: {error.strerror}") from None
    return path


def check_out(out: str | Path, log: Path) -> Path:
    """The path, if it can be written and is not the log itself; else FluxobsError."""
    out = Path(out)
    if out.suffix not in (".parquet", ".csv"):
        raise FluxobsError(f"{out}: --out must end in .parquet or .csv")
    check_place(out)
    if out.exists() and log.exists() and out.samefile(log):
        raise FluxobsError(f"{out}: --out is the log itself; give another name")
    return out


def write_text(out: Path, text: str) -> None:
    """A text file: complete or not at all; FluxobsError if it cannot be written."""
    part_file = out.with_name(f".{out.name}.part")
    try:
        part_file.write_text(text, encoding="utf-8")
        part_file.replace(out)
    except OSError as error:
        raise FluxobsError(f"{out}: cannot be written: {error.strerror}") from None
    finally:
        part_file.unlink(missing_ok=True)


def write_rows(out: Path, schema: Schema, frames: Iterator[pl.DataFrame]) -> None:
    """Streams frames into .parquet or .csv; `out` appears only when all are written.

    Raises
    ------
    FluxobsError
        What making a frame raised, or that the file cannot be written.
    """
    failure: FluxobsError | None = None
    stop = threading.Event()

    def rows() -> Iterator[pl.DataFrame]:
        nonlocal failure
        try:
            for frame in frames:
                yield frame
                if stop.is_set():
                    return
        except FluxobsError as problem:  # Polars would wrap it: kept aside, raised below
            failure = problem

    try:
        handle, name = tempfile.mkstemp(suffix=".part", prefix=f".{out.name}.", dir=out.parent)
    except OSError as error:
        raise FluxobsError(f"{out}: cannot be written: {error.strerror}") from None
    os.close(handle)
    part_file = Path(name)
    try:
        lazy = register_io_source(lambda columns, predicate, n, size: rows(), schema=schema)
        _sink(lazy, part_file, out.suffix, stop)
        if failure is not None:
            raise failure
        part_file.chmod(0o666 & ~_umask())
        part_file.replace(out)
    except (OSError, pl.exceptions.PolarsError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise FluxobsError(f"{out}: cannot be written: {reason}") from None
    finally:
        part_file.unlink(missing_ok=True)


def _sink(lazy: pl.LazyFrame, path: Path, suffix: str, stop: threading.Event) -> None:
    """Writes in another thread, so that an interrupt reaches this one and ends the writing."""
    with ThreadPoolExecutor(max_workers=1) as writer:
        if suffix == ".csv":
            job = writer.submit(lazy.sink_csv, path)
        else:
            job = writer.submit(
                lazy.sink_parquet,
                path,
                compression="zstd",
                compression_level=1,
                statistics=False,
            )
        try:
            job.result()
        except BaseException:
            stop.set()
            raise


def ahead(parts: Iterator[Part]) -> Iterator[Part]:
    """The same parts; the next one is read while the present one is worked on."""
    with ThreadPoolExecutor(max_workers=1) as reader:
        coming = reader.submit(next, parts, None)
        while (part := coming.result()) is not None:
            coming = reader.submit(next, parts, None)
            yield part


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
