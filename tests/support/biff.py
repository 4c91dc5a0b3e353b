"""Write Excel 97 workbooks (.xls), which no installed library can write."""

from __future__ import annotations

import struct
from collections.abc import Iterable

Cell = tuple[int, int, float | str]

_END, _TABLE = 0xFFFFFFFE, 0xFFFFFFFD
_SECTOR = 512


def old_workbook(sheets: int, cells: Iterable[Cell]) -> bytes:
    """Return a workbook; the cells of a sheet are (row, column, number or text)."""
    sheet = _beginning(0x10) + b"".join(map(_cell, cells)) + _record(0xA)
    names = [b"\x03\0%03d" % n for n in range(sheets)]
    first = len(_beginning(5) + _record(0xA)) + sum(len(_record(0x85, bytes(6) + n)) for n in names)
    heads = [
        _record(0x85, struct.pack("<I2x", first + n * len(sheet)) + name)
        for n, name in enumerate(names)
    ]
    return _compound(_beginning(5) + b"".join(heads) + _record(0xA) + sheet * sheets)


def _record(kind: int, body: bytes = b"") -> bytes:
    return struct.pack("<2H", kind, len(body)) + body


def _beginning(kind: int) -> bytes:
    return _record(0x809, struct.pack("<4H2I", 0x600, kind, 0, 0, 0, 0x600))


def _cell(cell: Cell) -> bytes:
    row, column, value = cell
    if isinstance(value, str):
        body = struct.pack("<4HB", row, column, 0, len(value), 0)
        return _record(0x204, body + value.encode("latin-1"))
    return _record(0x203, struct.pack("<3Hd", row, column, 0, value))


def _compound(stream: bytes) -> bytes:
    """Return a compound file (OLE 2) with a stream named Workbook."""
    count = max(8, -(-len(stream) // _SECTOR))
    tables = -(-(count + 2) // 127)
    free = 0xFFFFFFFF
    head = bytes.fromhex("d0cf11e0a1b11ae1") + struct.pack("<16x5H6x", 0x3E, 3, 0xFFFE, 9, 6)
    head += struct.pack("<9I", 0, tables, tables, 0, 4096, _END, 0, _END, 0)
    head += struct.pack(f"<{tables}I", *range(tables))
    chain = [*[_TABLE] * tables, _END, *range(tables + 2, tables + 1 + count), _END]
    table = struct.pack(f"<{len(chain)}I", *chain)

    def entry(name: str, kind: int, child: int, start: int, size: int) -> bytes:
        text = f"{name}\0".encode("utf-16-le")
        about = struct.pack("<H2B3I36x", len(text), kind, 1, free, free, child)
        return text.ljust(64, b"\0") + about + struct.pack("<IQ", start, size)

    folder = entry("Root Entry", 5, 1, _END, 0)
    folder += entry("Workbook", 2, free, tables + 1, _SECTOR * count)
    return b"".join(
        [
            head.ljust(_SECTOR, b"\xff"),
            table.ljust(_SECTOR * tables, b"\xff"),
            folder.ljust(_SECTOR, b"\0"),
            stream.ljust(_SECTOR * count, b"\0"),
        ]
    )
