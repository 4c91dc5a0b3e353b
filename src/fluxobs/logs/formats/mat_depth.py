"""How deep the cells and structs of a MATLAB file are nested, before SciPy reads it.

SciPy calls itself for what is in a cell or a struct: a deep file overflows the stack and ends the
program. The elements are read here in the same order, without recursion.
"""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path
from typing import IO

#: Cells and structs within each other; those that MATLAB and Simulink write have some ten.
DEEPEST = 200
_CELL, _STRUCT, _OBJECT, _SPARSE, _FUNCTION, _OPAQUE = 1, 2, 3, 5, 16, 17
_COMPRESSED = 15
_COMPLEX = 0x800
_CHUNK = 1 << 16


def check_depth(path: Path) -> None:
    """Raise ValueError if a file is nested too deeply, or its elements cannot be followed."""
    with path.open("rb") as file:
        head = file.read(128)
        if len(head) < 128 or 0 in head[:4] or 2 in head[124:126]:  # of version 4, or 7.3
            return
        order = "<" if head[126:128] == b"IM" else ">"
        while len(tag := file.read(8)) == 8:
            kind, size = struct.unpack(f"{order}2I", tag)
            start = file.tell()
            try:
                elements = _Elements(file, order, kind == _COMPRESSED)
                if kind == _COMPRESSED:
                    elements.take(8)
                _follow(elements)
            except (struct.error, zlib.error) as error:
                raise ValueError(f"damaged: {error}") from None
            file.seek(start + size)


def _follow(elements: _Elements) -> None:
    """Pass over an array and all that is in it; those that are open hold so many more."""
    opened = [elements.array()]
    while opened:
        if opened[-1] == 0:
            opened.pop()
            continue
        if len(opened) > DEEPEST:
            raise ValueError(f"cells or structs are nested more than {DEEPEST} times")
        opened[-1] -= 1
        (_, size) = elements.words(2)
        if size:
            opened.append(elements.array())


class _Elements:
    """The elements of an array, one after the other."""

    def __init__(self, file: IO[bytes], order: str, packed: bool) -> None:
        self._file, self._order = file, order
        self._unpack = zlib.decompressobj() if packed else None
        self._ahead = b""

    def take(self, size: int) -> bytes:
        """The next bytes; fewer at the end."""
        if self._unpack is None:
            return self._file.read(size)
        while len(self._ahead) < size and not self._unpack.eof:
            packed = self._unpack.unconsumed_tail or self._file.read(_CHUNK)
            if not packed:
                break
            self._ahead += self._unpack.decompress(packed, _CHUNK)
        found, self._ahead = self._ahead[:size], self._ahead[size:]
        return found

    def words(self, count: int) -> tuple[int, ...]:
        return struct.unpack(f"{self._order}{count}I", self.take(4 * count))

    def _skip(self, size: int) -> None:
        if self._unpack is None:
            self._file.seek(size, 1)
            return
        while size > 0:
            if not (taken := self.take(min(size, _CHUNK))):
                raise struct.error("an element is cut off")
            size -= len(taken)

    def _sized(self) -> tuple[int, int]:
        """Bytes of the element that follows, and with what pads them; four fit into its tag."""
        (kind,) = self.words(1)
        if kind >> 16:
            return kind >> 16, 4
        (size,) = self.words(1)
        return size, size + -size % 8

    def element(self, most: int = 0) -> bytes:
        """The beginning of an element, which is passed over."""
        size, padded = self._sized()
        found = self.take(min(most, padded))
        self._skip(padded - len(found))
        return found[:size]

    def array(self) -> int:
        """Pass over the head of an array, and over its values; how many arrays it holds."""
        flags = self.words(4)[2]
        kind = flags & 0xFF
        if kind == _OPAQUE:
            for _ in range(3):
                self.element()
            return 1
        sizes = self.element(128)
        count: int = math.prod(struct.unpack(f"{self._order}{len(sizes) // 4}I", sizes))
        self.element()  # its name
        if kind == _FUNCTION:
            return 1
        if kind == _CELL:
            return count
        if kind in (_STRUCT, _OBJECT):
            return count * self._fields(kind)
        for _ in range((1 + bool(flags & _COMPLEX)) + 2 * (kind == _SPARSE)):
            self.element()
        return 0

    def _fields(self, kind: int) -> int:
        """How many fields the structs of an array have."""
        if kind == _OBJECT:
            self.element()  # its class
        length = int.from_bytes(self.element(4), "little" if self._order == "<" else "big")
        size, padded = self._sized()
        self._skip(padded)
        return size // length if length else 0
