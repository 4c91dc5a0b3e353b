"""Find the logs that files, patterns, folders and URLs denote, and name the logs."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

from ..errors import FluxobsError, UsageError
from ..logs.formats import FORMATS

#: Suffixes of text logs. In a folder, logs have one of these suffixes or that of a known format.
TEXT = (".csv", ".txt", ".tsv", ".lvm", ".asc", ".log", ".dat", ".gz")
#: Names of text files that are not logs.
WORDS = ("readme", "license", "licence", "changelog", "notes", "requirements")
#: Prefix of the name of a log outside the common folder of earlier runs.
ELSEWHERE = "@/"
#: A date in a name, with or without a time: 2024-05-17, 20240517_1430, 2024-05-17T14-30-05.
DATE = re.compile(
    r"(?<!\d)(20\d\d)[-_.]?(0[1-9]|1[0-2])[-_.]?(0[1-9]|[12]\d|3[01])"
    r"(?:[T_ -]?([01]\d|2[0-3])[-:_h.]?([0-5]\d)(?:[-:_m.]?([0-5]\d))?)?(?!\d)"
)


@dataclass(frozen=True)
class Source:
    """One log.

    Attributes
    ----------
    address : str
        A path, or a URL.
    name : str
        Path below the common folder of all logs; the results of the log have this name.
    drive : str
        The drive that recorded the log.
    """

    address: str
    name: str
    drive: str

    def __str__(self) -> str:
        return self.address

    @property
    def remote(self) -> bool:
        return "://" in self.address

    def stamp(self) -> str:
        """Return size and time of the log, to detect changes without reading it; empty if unknown.

        For a URL, return the key of its file system.
        """
        if self.remote:
            system, path = _filesystem(self.address)
            try:
                return str(system.ukey(path))
            except (OSError, NotImplementedError, KeyError):
                return ""
        try:
            stat = Path(self.address).stat()
        except OSError:
            return ""
        return f"{stat.st_size} {stat.st_mtime_ns}"

    def time(self) -> datetime | None:
        """Return the time of recording: the date in the name, else the file's last change."""
        dates = list(DATE.finditer(self.name))
        if dates:  # the last date: folders may have dates too
            year, month, day, hour, minute, second = (
                int(digits) if digits else 0 for digits in dates[-1].groups()
            )
            with suppress(ValueError):  # no such day, e.g. 31 February
                return datetime(year, month, day, hour, minute, second, tzinfo=UTC)
        if self.remote:
            return None
        try:
            return datetime.fromtimestamp(Path(self.address).stat().st_mtime, UTC)
        except OSError:
            return None

    @contextmanager
    def local(self) -> Iterator[Path]:
        """Provide the log as a local file; a remote log is fetched, and later deleted.

        Raises
        ------
        FluxobsError
            The log cannot be fetched.
        """
        if not self.remote:
            yield Path(self.address)
            return
        system, remote_path = _filesystem(self.address)
        with TemporaryDirectory(prefix="fluxobs-") as folder:
            path = Path(folder) / PurePosixPath(remote_path).name
            try:
                system.get_file(remote_path, str(path))
            except Exception as error:  # each file system raises different errors
                raise FluxobsError(
                    f"{self.address}: cannot be fetched: {_describe(error)}"
                ) from None
            yield path


def sources(
    logs: Sequence[str | Path], drive: str | None = None, root: str | None = None
) -> list[Source]:
    """Find the logs, each once, sorted by address.

    Parameters
    ----------
    logs : sequence of str or Path
        Files, patterns (``bench/**/*.csv``), folders (all logs in them and below), and URLs of
        these (``s3://bucket/bench/*.mf4``).
    drive : str, optional
        Regular expression that finds the drive in the path: its first group, or the whole match.
        Default: the folder of the log below the common folder of all logs.
    root : str, optional
        Common folder of the logs of an earlier run (:func:`shared`); it keeps the names of the
        logs.

    Raises
    ------
    FluxobsError
        No log is found, `drive` is malformed, or the library for a URL is missing.
    """
    try:
        pattern = None if drive is None else re.compile(drive)
    except re.error as error:
        raise UsageError(f"drive {drive!r} is not a regular expression: {error}") from None
    addresses: dict[str, None] = {}
    for log in logs:
        matches = _list_remote(str(log)) if "://" in str(log) else _list_local(str(log))
        if not matches:
            magic = glob.has_magic(str(log))
            reason = "no such file, and no file matches this pattern" if magic else "no logs there"
            raise FluxobsError(f"{log}: {reason}")
        addresses |= dict.fromkeys(matches)
    if root is None:
        root = shared(list(addresses))
    log_sources = []
    for address in sorted(addresses):
        name = _name_below(address, root)
        if pattern is None:
            folder = PurePosixPath(name).parent
            owner = folder.name if name.startswith(ELSEWHERE) else str(folder)
            owner = "" if owner == "." else owner
        else:
            match = pattern.search(address)
            if match is None:
                raise UsageError(f"{address}: {drive!r} does not match this path")
            owner = match.group(1) if pattern.groups else match.group()
        log_sources.append(Source(address, name, owner))
    return log_sources


def _name_below(address: str, root: str) -> str:
    """Return a name that stays inside the folder of the results, wherever the log is."""
    if address.startswith(root):
        return address.removeprefix(root)
    return ELSEWHERE + address.replace("://", "/").lstrip("/")


def _is_log(name: str) -> bool:
    path = PurePosixPath(name.lower())
    hidden = path.name.startswith(".") or path.stem in WORDS
    return not hidden and (path.suffix in FORMATS or path.suffix in TEXT)


def _is_there(path: Path) -> bool:
    """Accept files and broken links, whose row states the reason; reject pipes, which block."""
    return path.is_file() or (path.is_symlink() and not path.exists())


def _list_local(log: str) -> list[str]:
    path = Path(os.path.normpath(Path(log).absolute()))
    try:
        is_folder, is_there = path.is_dir(), path.exists()
    except OSError:  # no rights, or a name that is too long: its row states the reason
        return [path.as_posix()]
    if is_folder:
        entries = (entry for entry in path.rglob("*") if _is_there(entry) and _is_log(entry.name))
        # A folder of results holds tables, not logs.
        return [
            entry.as_posix()
            for entry in entries
            if not any((parent / "fleet.json").exists() for parent in entry.parents)
        ]
    if is_there or not glob.has_magic(log):
        return [path.as_posix()]  # a missing file gets a row with the reason
    matches = (Path(entry) for entry in glob.glob(str(path), recursive=True))
    return [entry.as_posix() for entry in matches if entry.is_file()]


def _list_remote(url: str) -> list[str]:
    system, pattern = _filesystem(url)
    scheme = url.partition("://")[0]
    try:
        if scheme in ("http", "https") and not glob.has_magic(url):
            return [url]
        if glob.has_magic(pattern):
            names = system.glob(pattern)
        elif system.isdir(pattern):
            names = [path for path in system.find(pattern) if _is_log(path)]
        else:
            names = [pattern]
    except Exception as error:  # each file system raises different errors
        raise FluxobsError(f"{url}: cannot be listed: {_describe(error)}") from None
    return [str(system.unstrip_protocol(path)) for path in names]


def _filesystem(address: str) -> tuple[Any, str]:
    """Return (file system of a URL, path in the file system)."""
    scheme = address.partition("://")[0]
    try:
        from fsspec.core import url_to_fs

        system, path = url_to_fs(address)
    except ImportError as error:
        raise FluxobsError(
            f'{address}: reading {scheme}:// needs the extra "cloud"; install it: '
            f'pip install "fluxobs[cloud]" ({error})'
        ) from None
    except ValueError as error:
        raise FluxobsError(f"{address}: {error}") from None
    return system, path


def _describe(error: Exception) -> str:
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__


def shared(addresses: Sequence[str]) -> str:
    """Return the common folder of all addresses, with a trailing slash."""
    if len(addresses) == 1:
        return addresses[0].rpartition("/")[0] + "/"
    lowest, highest = min(addresses), max(addresses)
    common = 0
    while common < min(len(lowest), len(highest)) and lowest[common] == highest[common]:
        common += 1
    return lowest[: lowest.rfind("/", 0, common) + 1]
