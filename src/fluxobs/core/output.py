"""Files that appear complete or not at all."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, TypeVar

import polars as pl
from polars.io.plugins import register_io_source

from ..errors import FluxobsError
from .locks import is_at, lock

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
    if os.path.lexists(path) and not force:
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
def replacing(out: Path, force: bool = True) -> Iterator[IO[bytes]]:
    """A new file beside `out`, which becomes it at the end, or is removed if that is not reached.

    Parameters
    ----------
    out : Path
    force : bool
        Whether it may replace a file that is there at the end.

    Raises
    ------
    FluxobsError
        It cannot be written, or another run is writing it.
    """
    unfinished = _unfinished(out)
    try:
        with claimed(out) as handle:
            _check_missing(out, force)
            yield handle
            handle.flush()
            if not is_at(handle.fileno(), unfinished):  # only without locks
                raise _busy(out)
            _check_missing(out, force)
            if os.name == "nt":  # Windows moves no open file
                handle.close()
            unfinished.replace(out)
    except OSError as error:
        raise FluxobsError(f"{out}: cannot be written: {error.strerror or error}") from None


def _check_missing(out: Path, force: bool) -> None:
    """Raise FluxobsError if somebody has made the file since the run began."""
    if not force and os.path.lexists(out):
        raise FluxobsError(
            f"{out}: exists, and was made during this run; give another name, or --force to "
            f"overwrite it"
        )


def _unfinished(out: Path) -> Path:
    return out.with_name(f".{out.name}.part")


@contextmanager
def claimed(out: Path) -> Iterator[IO[bytes]]:
    """The unfinished file of an output, made anew and locked for this run; it is gone at the end.

    Raises
    ------
    FluxobsError
        Another run is writing this output.
    """
    unfinished = _unfinished(out)
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
    while True:
        _remove_left(unfinished, out)
        with suppress(FileExistsError):  # another run was faster: it is asked again
            handle = os.fdopen(os.open(unfinished, flags, 0o666), "wb")
            if lock(handle.fileno()) and is_at(handle.fileno(), unfinished):
                break
            handle.close()
    try:
        yield handle
    finally:
        try:
            if os.name == "nt":  # Windows removes no open file
                handle.close()
            if os.name == "nt" or is_at(handle.fileno(), unfinished):
                unfinished.unlink(missing_ok=True)
        finally:
            handle.close()


def _remove_left(unfinished: Path, out: Path) -> None:
    """Remove what a killed run left, or a link, through which nothing is written.

    Raises
    ------
    FluxobsError
        The run that writes it still goes on.
    """
    if os.name == "nt" or unfinished.is_symlink():  # Windows removes no file that is open
        unfinished.unlink(missing_ok=True)
        return
    try:
        # Without waiting: it may be a pipe.
        left = os.open(unfinished, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except FileNotFoundError:
        return
    try:
        if not lock(left):
            raise _busy(out)
        if is_at(left, unfinished):
            unfinished.unlink()
    finally:
        os.close(left)


def _busy(out: Path) -> FluxobsError:
    return FluxobsError(f"{out}: another run is writing it; wait for its end, or stop it")


def write_text(out: Path, text: str) -> None:
    """Write a text file, complete or not at all; FluxobsError if it cannot be written."""
    with replacing(out) as handle:
        # The name of a file may have bytes that are no character.
        handle.write(text.encode(errors="backslashreplace"))


def write_rows(
    out: Path, schema: Schema, frames: Iterator[pl.DataFrame], force: bool = True
) -> None:
    """Stream frames into .parquet or .csv; `out` appears only when all are written.

    Raises
    ------
    FluxobsError
        Making a frame raised it, the file cannot be written, another run is writing it, or it
        appeared meanwhile and `force` is not given.
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

    lazy = register_io_source(lambda columns, predicate, n, size: rows(), schema=schema)
    with replacing(out, force) as handle:
        try:
            _sink(lazy, handle, out.suffix, stop)
        except pl.exceptions.PolarsError as error:
            raise FluxobsError(f"{out}: cannot be written: {error}") from None
        if failure is not None:
            raise failure


def _sink(lazy: pl.LazyFrame, file: IO[bytes], suffix: str, stop: threading.Event) -> None:
    """Write in another thread, so that an interrupt reaches this one and ends the writing."""
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


def ahead(parts: Iterator[Part]) -> Iterator[Part]:
    """Yield the same parts, and read the next one while the caller works on the current one."""
    with ThreadPoolExecutor(max_workers=1) as reader:
        coming = reader.submit(next, parts, None)
        while (part := coming.result()) is not None:
            coming = reader.submit(next, parts, None)
            yield part
