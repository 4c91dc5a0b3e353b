"""Check memory and nesting of a MATLAB file before SciPy reads it.

SciPy unpacks the whole file and recurses into cells and structs: a deeply nested file overflows the
stack and ends the program. This module reads the elements in the same order without recursion.
"""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path
from typing import IO

from ...core.input_files import most_unpacked

#: Deepest nesting of cells and structs; files of MATLAB and Simulink have about ten levels.
DEEPEST = 200
_CELL, _STRUCT, _OBJECT, _SPARSE, _FUNCTION, _OPAQUE = 1, 2, 3, 5, 16, 17
_COMPRESSED = 15
_CHARACTERS = 4
_COMPLEX = 0x800
_CHUNK = 1 << 16
#: Largest memory beyond the size of the file [bytes]: MATLAB's own limit for a variable.
MOST = 1 << 31
#: Bytes counted for an array in a cell or struct. Even an empty array needs 400 bytes and 30 µs.
ARRAY = 2000
#: Bytes of memory per byte of a text or of a complex number. SciPy converts texts to wide
#: characters, and creates additional arrays of complex numbers in double precision.
TEXT, COMPLEX = 16, 17


def check_size(path: Path) -> None:
    """Raise ValueError if a file is nested too deeply, needs too much memory, or is damaged."""
    size = path.stat().st_size
    memory = _Memory(min(most_unpacked(path), MOST + size))
    with path.open("rb") as file:
        head = file.read(128)
        if len(head) < 128 or 0 in head[:4] or 2 in head[124:126]:  # version 4 or 7.3
            return
        order = "<" if head[126:128] == b"IM" else ">"
        while len(tag := file.read(8)) == 8:
            kind, size = struct.unpack(f"{order}2I", tag)
            start = file.tell()
            try:
                elements = _Elements(file, order, kind == _COMPRESSED, memory)
                if kind == _COMPRESSED:
                    elements.take(8)
                _skip_array(elements)
            except (struct.error, zlib.error) as error:
                raise ValueError(f"damaged: {error}") from None
            file.seek(start + size)


class _Memory:
    """Memory that the rest of a file may need."""

    def __init__(self, limit: int) -> None:
        self._limit = self._available = limit

    def take(self, size: int) -> None:
        """Count memory; raise ValueError if the limit is exceeded."""
        self._available -= size
        if self._available < 0:
            raise ValueError(
                f"it unpacks to more than {self._limit >> 20} MB. Save only the channels, or save "
                f"with -v7.3: of such a file, only the channels are read"
            )


def _skip_array(elements: _Elements) -> None:
    """Skip an array with all its contents; `opened` counts the remaining arrays of each level."""
    opened = [elements.array()]
    while opened:
        if opened[-1] == 0:
            opened.pop()
            continue
        if len(opened) > DEEPEST:
            raise ValueError(f"cells or structs are nested more than {DEEPEST} levels deep")
        opened[-1] -= 1
        (_, size) = elements.words(2)
        if size:
            opened.append(elements.array())


class _Elements:
    """Elements of an array, read in order."""

    def __init__(self, file: IO[bytes], order: str, compressed: bool, memory: _Memory) -> None:
        self._file, self._order, self._memory = file, order, memory
        self._unpacker = zlib.decompressobj() if compressed else None
        self._ahead, self._at = b"", 0

    def take(self, size: int) -> bytes:
        """Return the next `size` bytes, or fewer at the end of the file."""
        if self._unpacker is None:
            return self._file.read(size)
        while len(self._ahead) - self._at < size and not self._unpacker.eof:
            compressed = self._unpacker.unconsumed_tail or self._file.read(_CHUNK)
            if not compressed:
                break
            self._ahead = self._ahead[self._at :] + self._unpacker.decompress(compressed, _CHUNK)
            self._at = 0
        content = self._ahead[self._at : self._at + size]
        self._at += len(content)
        return content

    def words(self, count: int) -> tuple[int, ...]:
        return struct.unpack(f"{self._order}{count}I", self.take(4 * count))

    def _skip(self, size: int) -> None:
        if self._unpacker is None:
            self._file.seek(size, 1)
            return
        while size > 0:
            if not (content := self.take(min(size, _CHUNK))):
                raise struct.error("an element is cut off")
            size -= len(content)

    def _sized(self) -> tuple[int, int]:
        """Return the next element's size without and with padding; four bytes fit into the tag."""
        (kind,) = self.words(1)
        if kind >> 16:
            return kind >> 16, 4
        (size,) = self.words(1)
        return size, size + -size % 8

    def element(self, wanted: int = 0, factor: int = 1) -> bytes:
        """Skip an element, count its memory, and return its first `wanted` bytes."""
        size, padded = self._sized()
        self._memory.take(factor * size)
        start = self.take(min(wanted, padded))
        self._skip(padded - len(start))
        return start[:size]

    def array(self) -> int:
        """Skip the head and the values of an array; return the number of arrays inside."""
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
            arrays = count * (1 if kind == _CELL else self._fields(kind))
            self._memory.take(ARRAY * max(count, arrays))
            return arrays
        values = 1 + bool(flags & _COMPLEX)
        factor = TEXT if kind == _CHARACTERS else COMPLEX if values == 2 else 1
        for _ in range(values + 2 * (kind == _SPARSE)):
            self.element(factor=factor)
        return 0

    def _fields(self, kind: int) -> int:
        """Return the number of fields of a struct array."""
        if kind == _OBJECT:
            self.element()  # its class
        length = int.from_bytes(self.element(4), "little" if self._order == "<" else "big")
        size, padded = self._sized()
        self._skip(padded)
        return size // length if length else 0
