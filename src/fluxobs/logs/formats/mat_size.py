"""How much memory a MATLAB file takes, and how deep it is nested, before SciPy reads it.

SciPy unpacks all that a file holds, and calls itself for what is in a cell or a struct: a deep file
overflows the stack and ends the program. The elements are read here in the same order, without
recursion.
"""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path
from typing import IO

from ...core.input_files import most_unpacked

#: Cells and structs within each other; those that MATLAB and Simulink write have some ten.
DEEPEST = 200
_CELL, _STRUCT, _OBJECT, _SPARSE, _FUNCTION, _OPAQUE = 1, 2, 3, 5, 16, 17
_COMPRESSED = 15
_CHARACTERS = 4
_COMPLEX = 0x800
_CHUNK = 1 << 16
#: Most bytes of memory besides those of the file: MATLAB's own limit for a variable.
MOST = 1 << 31
#: Bytes that an array in a cell or a struct counts for, be it empty: it takes 400, and 30 µs.
ARRAY = 2000
#: Bytes of memory for a byte of a text, and of a complex number: SciPy makes wide characters of it,
#: and adds arrays of complex numbers in double precision.
TEXT, COMPLEX = 16, 17


def check_size(path: Path) -> None:
    """Raise ValueError if a file is nested too deeply, would take too much memory, or its elements
    cannot be followed."""
    size = path.stat().st_size
    memory = _Memory(min(most_unpacked(path), MOST + size))
    with path.open("rb") as file:
        head = file.read(128)
        if len(head) < 128 or 0 in head[:4] or 2 in head[124:126]:  # of version 4, or 7.3
            return
        order = "<" if head[126:128] == b"IM" else ">"
        while len(tag := file.read(8)) == 8:
            kind, size = struct.unpack(f"{order}2I", tag)
            start = file.tell()
            try:
                elements = _Elements(file, order, kind == _COMPRESSED, memory)
                if kind == _COMPRESSED:
                    elements.take(8)
                _follow(elements)
            except (struct.error, zlib.error) as error:
                raise ValueError(f"damaged: {error}") from None
            file.seek(start + size)


class _Memory:
    """What is left of the memory that a file may take."""

    def __init__(self, most: int) -> None:
        self._most = self._left = most

    def take(self, size: int) -> None:
        """Take some of it."""
        self._left -= size
        if self._left < 0:
            raise ValueError(
                f"it unpacks to more than {self._most >> 20} MB. Save the channels alone, or with "
                f"-v7.3, of which only the channels are read"
            )


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

    def __init__(self, file: IO[bytes], order: str, packed: bool, memory: _Memory) -> None:
        self._file, self._order, self._memory = file, order, memory
        self._unpack = zlib.decompressobj() if packed else None
        self._ahead, self._at = b"", 0

    def take(self, size: int) -> bytes:
        """The next bytes; fewer at the end."""
        if self._unpack is None:
            return self._file.read(size)
        while len(self._ahead) - self._at < size and not self._unpack.eof:
            packed = self._unpack.unconsumed_tail or self._file.read(_CHUNK)
            if not packed:
                break
            self._ahead = self._ahead[self._at :] + self._unpack.decompress(packed, _CHUNK)
            self._at = 0
        taken = self._ahead[self._at : self._at + size]
        self._at += len(taken)
        return taken

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

    def element(self, most: int = 0, times: int = 1) -> bytes:
        """The beginning of an element, which is passed over; its bytes take memory."""
        size, padded = self._sized()
        self._memory.take(times * size)
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
        if kind in (_CELL, _STRUCT, _OBJECT):
            held = count * (1 if kind == _CELL else self._fields(kind))
            self._memory.take(ARRAY * max(count, held))
            return held
        parts = 1 + bool(flags & _COMPLEX)
        times = TEXT if kind == _CHARACTERS else COMPLEX if parts == 2 else 1
        for _ in range(parts + 2 * (kind == _SPARSE)):
            self.element(times=times)
        return 0

    def _fields(self, kind: int) -> int:
        """How many fields the structs of an array have."""
        if kind == _OBJECT:
            self.element()  # its class
        length = int.from_bytes(self.element(4), "little" if self._order == "<" else "big")
        size, padded = self._sized()
        self._skip(padded)
        return size // length if length else 0
