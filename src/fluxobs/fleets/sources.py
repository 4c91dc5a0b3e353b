"""Many logs: files, patterns, folders and addresses to a list of names."""

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

#: Endings of text logs; in a folder, files with other endings are no logs.
TEXT = (".csv", ".txt", ".tsv", ".lvm", ".asc", ".log", ".dat", ".gz")
#: Names of texts that are no logs.
WORDS = ("readme", "license", "licence", "changelog", "notes", "requirements")
#: Begins the name of a log that is not in the folder which those of earlier runs shared.
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
        Its path below what all logs share; names what is written of it.
    drive : str
        The drive it belongs to.
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
        """What changes when the log does, without reading it; empty if it cannot be had."""
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
        """When it was recorded: the date in its name, else when the file was last written."""
        dates = list(DATE.finditer(self.name))
        if dates:  # the last: folders may have dates too
            year, month, day, hour, minute, second = (
                int(part) if part else 0 for part in dates[-1].groups()
            )
            with suppress(ValueError):  # the 31st of February
                return datetime(year, month, day, hour, minute, second, tzinfo=UTC)
        if self.remote:
            return None
        try:
            return datetime.fromtimestamp(Path(self.address).stat().st_mtime, UTC)
        except OSError:
            return None

    @contextmanager
    def local(self) -> Iterator[Path]:
        """The log as a file of this machine, for as long as it is needed.

        Raises
        ------
        FluxobsError
            It cannot be fetched.
        """
        if not self.remote:
            yield Path(self.address)
            return
        system, path = _filesystem(self.address)
        with TemporaryDirectory(prefix="fluxobs-") as folder:
            place = Path(folder) / PurePosixPath(path).name
            try:
                system.get_file(path, str(place))
            except Exception as error:  # every file system has errors of its own
                raise FluxobsError(f"{self.address}: cannot be fetched: {_told(error)}") from None
            yield place


def sources(
    given: Sequence[str | Path], drive: str | None = None, root: str | None = None
) -> list[Source]:
    """The logs that are meant, each once, by name.

    Parameters
    ----------
    given : sequence of str or Path
        Files, patterns (``bench/**/*.csv``), folders (every log in them and below), and URLs of
        these (``s3://bucket/bench/*.mf4``).
    drive : str, optional
        Regular expression that finds the drive in the path: its first group, or all of it. Default:
        the folder of the log below what all logs share.
    root : str, optional
        What the logs of an earlier run shared (:func:`shared`): names stay what they were.

    Raises
    ------
    FluxobsError
        Nothing is there, the pattern is none, or a library for the address is missing.
    """
    try:
        pattern = None if drive is None else re.compile(drive)
    except re.error as error:
        raise UsageError(f"drive {drive!r} is no regular expression: {error}") from None
    found: dict[str, None] = {}
    for one in given:
        addresses = _remote(str(one)) if "://" in str(one) else _local(str(one))
        if not addresses:
            magic = glob.has_magic(str(one))
            words = "no such file, and as a pattern it matches none" if magic else "no logs there"
            raise FluxobsError(f"{one}: {words}")
        found |= dict.fromkeys(addresses)
    if root is None:
        root = shared(list(found))
    out = []
    for address in sorted(found):
        name = _name(address, root)
        if pattern is None:
            folder = PurePosixPath(name).parent
            whose = folder.name if name.startswith(ELSEWHERE) else str(folder)
            whose = "" if whose == "." else whose
        else:
            hit = pattern.search(address)
            if hit is None:
                raise UsageError(f"{address}: {drive!r} finds no drive in this path")
            whose = hit.group(1) if pattern.groups else hit.group()
        out.append(Source(address, name, whose))
    return out


def _name(address: str, root: str) -> str:
    """A name stays in the folder of the results, wherever its log is."""
    if address.startswith(root):
        return address.removeprefix(root)
    return ELSEWHERE + address.replace("://", "/").lstrip("/")


def _is_log(name: str) -> bool:
    path = PurePosixPath(name.lower())
    hidden = path.name.startswith(".") or path.stem in WORDS
    return not hidden and (path.suffix in FORMATS or path.suffix in TEXT)


def _is_there(path: Path) -> bool:
    """A file, or a link to one that is missing: a row says so. A pipe would never end."""
    return path.is_file() or (path.is_symlink() and not path.exists())


def _local(given: str) -> list[str]:
    path = Path(os.path.normpath(Path(given).absolute()))
    if path.is_dir():
        below = (one for one in path.rglob("*") if _is_there(one) and _is_log(one.name))
        # The folder of a result holds tables, no logs.
        return [
            one.as_posix()
            for one in below
            if not any((above / "fleet.json").exists() for above in one.parents)
        ]
    if path.exists() or not glob.has_magic(given):
        return [path.as_posix()]  # a missing one is a row that says so
    hits = (Path(one) for one in glob.glob(str(path), recursive=True))
    return [one.as_posix() for one in hits if one.is_file()]


def _remote(given: str) -> list[str]:
    system, path = _filesystem(given)
    scheme = given.partition("://")[0]
    try:
        if scheme in ("http", "https") and not glob.has_magic(given):
            return [given]
        if glob.has_magic(path):
            names = system.glob(path)
        elif system.isdir(path):
            names = [one for one in system.find(path) if _is_log(one)]
        else:
            names = [path]
    except Exception as error:  # every file system has errors of its own
        raise FluxobsError(f"{given}: cannot be listed: {_told(error)}") from None
    return [str(system.unstrip_protocol(one)) for one in names]


def _filesystem(address: str) -> tuple[Any, str]:
    """The file system of a URL, and the path in it."""
    scheme = address.partition("://")[0]
    try:
        from fsspec.core import url_to_fs

        system, path = url_to_fs(address)
    except ImportError as error:
        raise FluxobsError(
            f'{address}: reading {scheme}:// needs the extra "cloud": '
            f'pip install "fluxobs[cloud]" ({error})'
        ) from None
    except ValueError as error:
        raise FluxobsError(f"{address}: {error}") from None
    return system, path


def _told(error: Exception) -> str:
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__


def shared(addresses: Sequence[str]) -> str:
    """The folder that all of them are in, with its last slash."""
    if len(addresses) == 1:
        return addresses[0].rpartition("/")[0] + "/"
    first, last = min(addresses), max(addresses)
    same = 0
    while same < min(len(first), len(last)) and first[same] == last[same]:
        same += 1
    return first[: first.rfind("/", 0, same) + 1]
