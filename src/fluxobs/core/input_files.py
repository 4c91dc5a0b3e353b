"""Files that people give: regular ones, what they may unpack to, and TOML of theirs."""

from __future__ import annotations

import tomllib
import zlib
from pathlib import Path
from typing import Any

from ..errors import FluxobsError

#: Most bytes of a TOML file. Those that are shipped have three thousand; the time to parse a name
#: of many parts grows with their square.
MOST = 1 << 15
#: Tables and lists within each other.
DEEPEST = 50
#: Libraries unpack a block of a file to whatever comes out of it: a thousand times its size, by
#: zlib. A larger one is unpacked before, up to the size that it should have.
PACKED_BLOCK = 1 << 20
#: Most bytes of a block, which is unpacked as a whole; usual ones have a few million.
BLOCK = 1 << 28
#: Every file may unpack to so many bytes, and to so many times its size: rows whose time goes on
#: pack to a twentieth, rows that repeat to a thousandth.
PLENTY, RATIO = 1 << 28, 200


def most_unpacked(path: Path) -> int:
    """Most bytes that a compressed file may unpack to; a bomb has more."""
    return max(PLENTY, RATIO * path.stat().st_size)


def check_deflated(packed: bytes, size: int, what: str) -> None:
    """Raise ValueError if a stream of zlib unpacks to more bytes than the file says."""
    unpack = zlib.decompressobj()
    unpack.decompress(packed, max(size, 1))  # 0 is no limit
    if unpack.unconsumed_tail and unpack.decompress(unpack.unconsumed_tail, 1):
        raise ValueError(f"{what} unpacks to more than the {size} bytes that it should have")


def check_regular(path: Path, error: type[FluxobsError]) -> None:
    """Raise `error` for a pipe or a device, which may wait for ever, or bring bytes without end."""
    if path.exists() and not path.is_file() and not path.is_dir():
        raise error(f"{path}: this is a pipe or a device; save what it brings as a file")


def read_toml(path: Path, error: type[FluxobsError]) -> dict[str, Any]:
    """Parse a TOML file; raise `error` if it is malformed or cannot be read."""
    check_regular(path, error)
    try:
        with path.open("rb") as file:
            content = file.read(MOST + 1)
    except (OSError, ValueError) as problem:
        raise error(f"{path}: cannot be read: {getattr(problem, 'strerror', problem)}") from None
    if len(content) > MOST:
        raise error(f"{path}: larger than {MOST} bytes, which no such file needs")
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as problem:
        raise error(f"{path}: not TOML: {problem}") from None
    return parse_toml(text.replace("\r\n", "\n"), str(path), error)


def parse_toml(text: str, where: str, error: type[FluxobsError]) -> dict[str, Any]:
    """Parse TOML; raise `error` if it is malformed or nested too deeply."""
    try:
        found = tomllib.loads(text)
        _check_values(found)
    except RecursionError:
        raise error(f"{where}: not TOML: nested too deeply") from None
    except ValueError as problem:
        raise error(f"{where}: not TOML: {problem}") from None
    return found


def _check_values(found: dict[str, Any]) -> None:
    """Raise ValueError for what no file needs, and cannot be shown or computed with."""
    values: list[Any] = [found]
    for _ in range(DEEPEST):
        if any(isinstance(one, int) and abs(one) >= 1 << 63 for one in values):
            raise ValueError("an integer has more than 64 bits")
        tables = [one.values() for one in values if isinstance(one, dict)]
        lists = [one for one in values if isinstance(one, list)]
        values = [one for part in (*tables, *lists) for one in part]
    if values:
        raise ValueError("nested too deeply")
