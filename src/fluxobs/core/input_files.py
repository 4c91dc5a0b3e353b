"""Checks of input files: regular files, limits of unpacked size, and TOML."""

from __future__ import annotations

import tomllib
import zlib
from pathlib import Path
from typing import Any

from ..errors import FluxobsError

#: Largest TOML file [bytes]. Shipped files have three thousand bytes; the time to parse a dotted
#: key grows with the square of the key's length.
MAX_TOML_BYTES = 1 << 15
#: Deepest nesting of tables and lists.
MAX_DEPTH = 50
#: Libraries unpack a block of a file without a limit; zlib can expand a block a thousandfold. A
#: packed block larger than this [bytes] is first unpacked here, up to the size that the file
#: states.
PACKED_BLOCK = 1 << 20
#: Largest unpacked block [bytes]; a block is unpacked whole. Usual blocks have a few million bytes.
BLOCK = 1 << 28
#: A file may unpack to this many bytes, or to this many times its size if that is more. Packing
#: shrinks rows with increasing time to a twentieth, repeated rows to a thousandth.
PLENTY, RATIO = 1 << 28, 200


def most_unpacked(path: Path) -> int:
    """Return the most bytes that a file may unpack to; a decompression bomb exceeds this limit."""
    return max(PLENTY, RATIO * path.stat().st_size)


def check_deflated(packed: bytes, size: int, name: str) -> None:
    """Raise ValueError if a zlib stream unpacks to more than the `size` that the file states."""
    unpack = zlib.decompressobj()
    unpack.decompress(packed, max(size, 1))  # 0 means no limit
    if unpack.unconsumed_tail and unpack.decompress(unpack.unconsumed_tail, 1):
        raise ValueError(f"{name} unpacks to more than the {size} bytes that the file states")


def check_regular(path: Path, error: type[FluxobsError]) -> None:
    """Raise `error` for a pipe or a device: reading it may block or never end."""
    if path.exists() and not path.is_file() and not path.is_dir():
        raise error(f"{path}: this is a pipe or a device; save its data as a file")


def read_toml(path: Path, error: type[FluxobsError]) -> dict[str, Any]:
    """Parse a TOML file; raise `error` if it is malformed or cannot be read."""
    check_regular(path, error)
    try:
        with path.open("rb") as file:
            content = file.read(MAX_TOML_BYTES + 1)
    except (OSError, ValueError) as problem:
        raise error(f"{path}: cannot be read: {getattr(problem, 'strerror', problem)}") from None
    if len(content) > MAX_TOML_BYTES:
        raise error(f"{path}: larger than {MAX_TOML_BYTES} bytes, the limit of a TOML file")
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as problem:
        raise error(f"{path}: not TOML: {problem}") from None
    return parse_toml(text.replace("\r\n", "\n"), str(path), error)


def parse_toml(text: str, where: str, error: type[FluxobsError]) -> dict[str, Any]:
    """Parse TOML; raise `error` if it is malformed or nested too deeply."""
    try:
        tables = tomllib.loads(text)
        _check_values(tables)
    except RecursionError:
        raise error(f"{where}: not TOML: nested too deeply") from None
    except ValueError as problem:
        raise error(f"{where}: not TOML: {problem}") from None
    return tables


def _check_values(content: dict[str, Any]) -> None:
    """Raise ValueError for integers beyond 64 bits and for nesting beyond :data:`MAX_DEPTH`."""
    values: list[Any] = [content]
    for _ in range(MAX_DEPTH):
        if any(isinstance(value, int) and abs(value) >= 1 << 63 for value in values):
            raise ValueError("an integer has more than 64 bits")
        tables = [value.values() for value in values if isinstance(value, dict)]
        lists = [value for value in values if isinstance(value, list)]
        values = [value for container in (*tables, *lists) for value in container]
    if values:
        raise ValueError("nested too deeply")
