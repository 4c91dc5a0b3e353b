"""Output files that appear complete or not at all."""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, TypeVar

import polars as pl
from polars.io.plugins import register_io_source

from ..errors import FluxobsError
from .forks import use_polars
from .locks import is_at, lock

Item = TypeVar("Item")
Done = TypeVar("Done")
Schema = dict[str, pl.DataType | type[pl.DataType]]


def check_place(path: Path) -> None:
    """Raise FluxobsError if the path is a folder, or lies in a folder that does not exist."""
    if path.is_dir():
        raise FluxobsError(f"{path}: this is a folder")
    if not path.parent.is_dir():
        raise FluxobsError(f"{path}: the folder {path.parent} does not exist")


#: Formats of a table.
TABLES = (".parquet", ".csv")


def make_folder(path: str | Path, result: str | None = None, force: bool = True) -> Path:
    """Create the folder if it is missing.

    Raises
    ------
    FluxobsError
        The folder cannot be created, or contains a file `result` already and `force` is false.
    """
    path = Path(path)
    if result is not None and (path / result).exists() and not force:
        raise FluxobsError(
            f"{path / result}: exists; give another folder, or --force to overwrite it"
        )
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FluxobsError(f"{path}: cannot be created: {error.strerror}") from None
    return path


def check_new(path: Path, endings: Sequence[str], force: bool, option: str = "--out") -> None:
    """Raise FluxobsError for a wrong ending, no folder, or an existing file without `force`."""
    if path.suffix.lower() not in endings:
        choice = f"{', '.join(endings[:-1])} or {endings[-1]}" if endings[1:] else endings[0]
        raise FluxobsError(f"{path}: {option} must end in {choice}")
    check_place(path)
    if os.path.lexists(path) and not force:
        raise FluxobsError(f"{path}: exists; give another name, or --force to overwrite it")


def check_out(out: str | Path, log: Path, force: bool = False) -> Path:
    """Return the path of an output table; raise FluxobsError if it must not be written.

    The table must be .parquet or .csv, differ from the log, and be new unless `force` is true.
    """
    out = Path(out)
    if out.exists() and log.exists() and out.samefile(log):
        raise FluxobsError(f"{out}: --out is the log itself; give another name")
    check_new(out, TABLES, force)
    return out


@contextmanager
def replacing(out: Path, force: bool = True) -> Iterator[IO[bytes]]:
    """Yield a temporary file beside `out`; it replaces `out` at the end, or is removed on failure.

    Parameters
    ----------
    out : Path
    force : bool
        Whether the result may replace a file that exists at the end.

    Raises
    ------
    FluxobsError
        The file cannot be written, or another run is writing it.
    """
    temporary = _temporary(out)
    try:
        with claimed(out) as handle:
            _check_missing(out, force)
            yield handle
            handle.flush()
            if not is_at(handle.fileno(), temporary):  # possible only without locks
                raise _busy(out)
            _check_missing(out, force)
            if os.name == "nt":  # Windows cannot move an open file
                handle.close()
            temporary.replace(out)
    except OSError as error:
        raise FluxobsError(f"{out}: cannot be written: {error.strerror or error}") from None


def _check_missing(out: Path, force: bool) -> None:
    """Raise FluxobsError if the file has appeared since the run began, unless `force`."""
    if not force and os.path.lexists(out):
        raise FluxobsError(
            f"{out}: exists, created during this run; give another name, or --force to overwrite it"
        )


def _temporary(out: Path) -> Path:
    return out.with_name(f".{out.name}.part")


@contextmanager
def claimed(out: Path) -> Iterator[IO[bytes]]:
    """Create and lock the temporary file of an output for this run; remove it at the end.

    Raises
    ------
    FluxobsError
        Another run is writing this output.
    """
    temporary = _temporary(out)
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
    while True:
        _remove_stale(temporary, out)
        with suppress(FileExistsError):  # another run created the file first: try again
            handle = os.fdopen(os.open(temporary, flags, 0o666), "wb")
            if lock(handle.fileno()) and is_at(handle.fileno(), temporary):
                break
            handle.close()
    try:
        yield handle
    finally:
        try:
            if os.name == "nt":  # Windows cannot remove an open file
                handle.close()
            if os.name == "nt" or is_at(handle.fileno(), temporary):
                temporary.unlink(missing_ok=True)
        finally:
            handle.close()


def _remove_stale(temporary: Path, out: Path) -> None:
    """Remove the temporary file of a killed run, or a link in its place.

    Raises
    ------
    FluxobsError
        The run that writes the file is still running.
    """
    if os.name == "nt" or temporary.is_symlink():  # Windows refuses if the file is open
        temporary.unlink(missing_ok=True)
        return
    try:
        # Open without blocking, since the file may be a pipe.
        descriptor = os.open(temporary, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except FileNotFoundError:
        return
    try:
        if not lock(descriptor):
            raise _busy(out)
        if is_at(descriptor, temporary):
            temporary.unlink()
    finally:
        os.close(descriptor)


def _busy(out: Path) -> FluxobsError:
    return FluxobsError(
        f"{out}: another run is writing this file; wait until the run ends, or stop the run"
    )


def write_text(out: Path, text: str) -> None:
    """Write a text file, complete or not at all; FluxobsError if it cannot be written."""
    with replacing(out) as handle:
        # A file name may contain bytes that are not characters.
        handle.write(text.encode(errors="backslashreplace"))


def write_rows(
    out: Path, schema: Schema, frames: Iterator[pl.DataFrame], force: bool = True
) -> None:
    """Stream frames into .parquet or .csv; `out` appears only when all frames are written.

    Raises
    ------
    FluxobsError
        A frame raised it, the file cannot be written, another run is writing the file, or the file
        has appeared meanwhile and `force` is false.
    """
    use_polars()
    failure: FluxobsError | None = None
    stop = threading.Event()

    def guarded_frames() -> Iterator[pl.DataFrame]:
        nonlocal failure
        try:
            for frame in frames:
                yield frame
                if stop.is_set():
                    return
        except FluxobsError as problem:  # Polars would wrap the error; it is raised below
            failure = problem

    lazy = register_io_source(lambda columns, predicate, n, size: guarded_frames(), schema=schema)
    with replacing(out, force) as handle:
        try:
            _sink(lazy, handle, out.suffix, stop)
        except pl.exceptions.PolarsError as error:
            raise FluxobsError(f"{out}: cannot be written: {error}") from None
        if failure is not None:
            raise failure


def _sink(lazy: pl.LazyFrame, file: IO[bytes], suffix: str, stop: threading.Event) -> None:
    """Write in another thread; an interrupt then reaches this thread and stops the writing."""
    with ThreadPoolExecutor(max_workers=1) as writer:
        if suffix == ".csv":
            job = writer.submit(lazy.sink_csv, file)
        else:
            job = writer.submit(
                lazy.sink_parquet,
                file,
                compression="zstd",
                compression_level=1,
                statistics=False,
            )
        try:
            job.result()
        except BaseException:
            stop.set()
            raise


def ahead(items: Iterator[Item]) -> Iterator[Item]:
    """Yield the items; read the next item while the caller works on the current item."""
    with ThreadPoolExecutor(max_workers=1) as reader:
        upcoming = reader.submit(next, items, None)
        while (item := upcoming.result()) is not None:
            upcoming = reader.submit(next, items, None)
            yield item


def in_parallel(function: Callable[[Item], Done], items: Iterable[Item]) -> Iterator[Done]:
    """Yield function(item) in the order of the items; threads work on several items at once."""
    workers = os.cpu_count() or 1
    with ThreadPoolExecutor(max_workers=workers) as pool:
        pending: deque[Future[Done]] = deque()
        for item in items:
            pending.append(pool.submit(function, item))
            if len(pending) >= workers:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
