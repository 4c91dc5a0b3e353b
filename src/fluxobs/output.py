"""Files that appear complete or not at all."""

from __future__ import annotations

import os
import tempfile
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, TypeVar

import polars as pl
from polars.io.plugins import register_io_source

from .errors import FluxobsError

Part = TypeVar("Part")
Schema = dict[str, pl.DataType | type[pl.DataType]]


def check_place(path: Path) -> None:
    """Raise FluxobsError if the path is a folder, or lies in a folder that does not exist."""
    if path.is_dir():
        raise FluxobsError(f"{path}: this is a folder")
    if not path.parent.is_dir():
        raise FluxobsError(f"{path}: the folder {path.parent} does not exist")


def make_folder(path: str | Path, result: str | None = None, force: bool = True) -> Path:
    """Make the folder if it is missing; FluxobsError if that fails, or if a `result` of that name
    is in it already and `force` is not given."""
    path = Path(path)
    if result is not None and (path / result).exists() and not force:
        raise FluxobsError(
            f"{path / result}: exists; give another folder, or --force to overwrite it"
        )
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FluxobsError(f"{path}: cannot be made: {error.strerror}") from None
    return path


def check_new(path: Path, endings: Sequence[str], force: bool, option: str = "--out") -> None:
    """Raise FluxobsError if a file cannot be written, or exists and `force` is not given."""
    if path.suffix.lower() not in endings:
        words = f"{', '.join(endings[:-1])} or {endings[-1]}" if endings[1:] else endings[0]
        raise FluxobsError(f"{path}: {option} must end in {words}")
    check_place(path)
    if path.exists() and not force:
        raise FluxobsError(f"{path}: exists; give another name, or --force to overwrite it")


def check_out(out: str | Path, log: Path, force: bool = False) -> Path:
    """Return the path if it can be written, is new or may be overwritten, and is not the log
    itself; else raise FluxobsError."""
    out = Path(out)
    if out.exists() and log.exists() and out.samefile(log):
        raise FluxobsError(f"{out}: --out is the log itself; give another name")
    check_new(out, (".parquet", ".csv"), force)
    return out


@contextmanager
def replacing(out: Path) -> Iterator[IO[bytes]]:
    """A new file beside `out`, which becomes it at the end, or is removed if that is not reached.

    Raises
    ------
    FluxobsError
        It cannot be written.
    """
    part_file = out.with_name(f".{out.name}.part")
    try:
        part_file.unlink(missing_ok=True)  # of a killed run; or a link, which "x" never follows
        with part_file.open("xb") as handle:
            yield handle
        part_file.replace(out)
    except OSError as error:
        raise FluxobsError(f"{out}: cannot be written: {error.strerror}") from None
    finally:
        with suppress(OSError):
            part_file.unlink()


def write_text(out: Path, text: str) -> None:
    """Write a text file, complete or not at all; FluxobsError if it cannot be written."""
    with replacing(out) as handle:
        handle.write(text.encode())


def write_rows(out: Path, schema: Schema, frames: Iterator[pl.DataFrame]) -> None:
    """Stream frames into .parquet or .csv; `out` appears only when all are written.

    Raises
    ------
    FluxobsError
        Making a frame raised it, or the file cannot be written.
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
        except FluxobsError as problem:  # Polars would wrap it: raised below
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
    """Write in another thread, so that an interrupt reaches this one and ends the writing."""
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
    """Yield the same parts, and read the next one while the caller works on the current one."""
    with ThreadPoolExecutor(max_workers=1) as reader:
        coming = reader.submit(next, parts, None)
        while (part := coming.result()) is not None:
            coming = reader.submit(next, parts, None)
            yield part


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
