"""Check the references between the blocks of an MDF file before asammdf follows them.

asammdf reads a chain of blocks to its end, but a circle of blocks has no end. For each reference to
a text or a nested conversion, asammdf creates a copy: two references at each of thirty levels make
a thousand million conversions.
"""

from __future__ import annotations

import mmap
import struct
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import ClassVar

from ...core.input_files import BLOCK, PACKED_BLOCK, PLENTY, check_deflated

#: Bytes that a conversion counts in addition to its size: they stand for its time. asammdf reads
#: 64 000 conversions in a second.
CONVERSION = 4000

Content = mmap.mmap | bytes


class _Layout(ABC):
    """Block layout of an MDF version.

    Attributes
    ----------
    first : int
        Address of the head.
    children : dict
        Kind of a block → indices of its links to other blocks: to the next block, or to the first
        block of a list.
    lists : tuple of bytes
        Kinds of lists of data, which channels may share.
    data : dict
        Kind of a block → indices of its links to lists of data.
    conversion : bytes
        Kind of a conversion.
    texts : tuple of bytes
        Kinds of texts.
    """

    first = 64
    children: ClassVar[dict[bytes, tuple[int, ...]]]
    lists: ClassVar[tuple[bytes, ...]] = ()
    data: ClassVar[dict[bytes, tuple[int, ...]]] = {}
    conversion: ClassVar[bytes]
    texts: ClassVar[tuple[bytes, ...]]

    def __init__(self, content: Content) -> None:
        self.content = content

    def kind(self, address: int) -> bytes:
        """Return the kind of the block at an address, or nothing outside the file."""
        return self.content[address : address + len(self.conversion)]

    @abstractmethod
    def size(self, address: int) -> int:
        """Return the length of a block [bytes]."""

    @abstractmethod
    def links(self, address: int) -> tuple[int, ...]:
        """Return the addresses that a block refers to; 0 for an unused link."""


class _Version4(_Layout):
    children: ClassVar = {
        b"##HD": (0, 1, 3, 4),
        b"##FH": (0,),
        b"##AT": (0,),
        b"##EV": (0,),
        b"##DG": (0, 1, 2),
        b"##CG": (0, 1),
        b"##CN": (0, 1),
        b"##CA": (0,),
        b"##HL": (0,),
        b"##DL": (0,),
        b"##LD": (0,),
    }
    lists = (b"##HL", b"##DL", b"##LD")
    data: ClassVar = {b"##CN": (5,)}
    conversion = b"##CC"
    texts = (b"##TX", b"##MD")
    _inverse = 3

    def size(self, address: int) -> int:
        (size,) = struct.unpack_from("<Q", self.content, address + 8)
        return min(int(size), len(self.content))

    def links(self, address: int) -> tuple[int, ...]:
        (count,) = struct.unpack_from("<Q", self.content, address + 16)
        count = min(count, (len(self.content) - address - 24) // 8)
        links = struct.unpack_from(f"<{count}Q", self.content, address + 24)
        if self.kind(address) == self.conversion:  # the inverse is not read, because it refers back
            return links[: self._inverse] + links[self._inverse + 1 :]
        return links


class _Version3(_Layout):
    children: ClassVar = {b"HD": (0,), b"DG": (0, 1), b"CG": (0, 1), b"CN": (0,)}
    conversion = b"CC"
    texts = (b"TX",)
    _counts: ClassVar = {b"HD": 3, b"DG": 2, b"CG": 3, b"CN": 5}
    #: Offsets of the texts in a range-to-text conversion: a default text, and one text per range.
    _ranges, _texts, _range = 12, 62, 20

    def size(self, address: int) -> int:
        (size,) = struct.unpack_from("<H", self.content, address + 2)
        return int(size)

    def links(self, address: int) -> tuple[int, ...]:
        kind = self.kind(address)
        if kind == self.conversion:
            conversion_type, count = struct.unpack_from("<2H", self.content, address + 42)
            start, end = address + self._texts, len(self.content) - 3
            places = range(start, min(start + self._range * count, end), self._range)
            texts = (struct.unpack_from("<I", self.content, place) for place in places)
            return tuple(text for (text,) in texts) if conversion_type == self._ranges else ()
        return struct.unpack_from(f"<{self._counts.get(kind, 0)}I", self.content, address + 4)


def check_blocks(path: Path) -> None:
    """Raise ValueError if asammdf would follow the blocks of a file without end, or need far more
    memory than the blocks.
    """
    with path.open("rb") as file:
        version = file.read(16)[8:9]
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            try:
                if version < b"4":
                    _follow_blocks(_Version3(content))
                    return
                blocks = _Version4(content)
                check_packed(path, _compressed_unsorted(blocks, _follow_blocks(blocks)))
            except struct.error as error:
                raise ValueError(f"damaged: {error}") from None


def check_packed(path: Path, blocks: Iterable[tuple[int, int, int]]) -> None:
    """Raise ValueError if data blocks are too large, or larger than their declared size.

    Parameters
    ----------
    path : path
    blocks : iterable of (int, int, int)
        (address, compressed size, unpacked size) of the content [bytes]. The compressed size is 0
        if zlib is not used.
    """
    with path.open("rb") as file:
        for address, packed, size in blocks:
            if size > BLOCK:
                raise ValueError(
                    f"a block of data unpacks to {size} bytes, more than {BLOCK}; write "
                    f"smaller blocks"
                )
            if packed > PACKED_BLOCK:
                file.seek(address)
                check_deflated(file.read(packed), size, "a block of data")


def _compressed_unsorted(blocks: _Version4, seen: set[int]) -> Iterator[tuple[int, int, int]]:
    """Yield compressed blocks of a file with unsorted rows, which asammdf unpacks on opening."""
    groups = (address for address in seen if blocks.kind(address) == b"##DG")
    if not any(blocks.content[address + 24 + 8 * 4] for address in groups):
        return
    for address in seen:
        for link in blocks.links(address):
            if blocks.kind(link) == b"##DZ":
                size, packed = struct.unpack_from("<2Q", blocks.content, link + 32)
                yield link + 48, packed if blocks.content[link + 26] < 2 else 0, size


def _follow_blocks(blocks: _Layout) -> set[int]:
    """Follow all blocks; return the addresses of the blocks that refer to other blocks."""
    pending, seen = [blocks.first], {blocks.first}
    limit = PLENTY + len(blocks.content)
    conversions: dict[int, int] = {}
    texts = 0
    while pending:
        address = pending.pop()
        links, kind = blocks.links(address), blocks.kind(address)
        for child in (links[n] for n in blocks.children.get(kind, ()) if n < len(links)):
            if blocks.kind(child) not in blocks.children:
                continue
            if child in seen:
                raise ValueError("its blocks refer to one another in a circle, or twice to a block")
            seen.add(child)
            pending.append(child)
        for data in (links[n] for n in blocks.data.get(kind, ()) if n < len(links)):
            if data not in seen and blocks.kind(data) in blocks.lists:
                seen.add(data)
                pending.append(data)
        for link in links:
            if blocks.kind(link) in blocks.texts:
                texts += blocks.size(link)
            elif blocks.kind(link) == blocks.conversion and link not in conversions:
                _add_conversion(blocks, link, conversions)
                texts += conversions[link]
        if texts > limit:
            raise ValueError(f"its texts and conversions need more than {limit >> 20} MB")
    return seen


def _add_conversion(blocks: _Layout, address: int, sizes: dict[int, int]) -> None:
    """Add the memory of a conversion to `sizes`, including every conversion that it refers to."""
    opened: list[tuple[int, Iterator[int]]] = [(address, iter(blocks.links(address)))]
    inside, totals = {address}, {address: CONVERSION + blocks.size(address)}
    while opened:
        address, links = opened[-1]
        for link in links:
            kind = blocks.kind(link)
            if kind in blocks.texts:
                totals[address] += blocks.size(link)
            elif kind != blocks.conversion:
                continue
            elif link in inside:
                raise ValueError("its conversions refer to one another in a circle")
            elif link in sizes:
                totals[address] += sizes[link]
            else:
                opened.append((link, iter(blocks.links(link))))
                inside.add(link)
                totals[link] = CONVERSION + blocks.size(link)
                break
        else:
            opened.pop()
            inside.remove(address)
            sizes[address] = totals[address]
            if opened:
                totals[opened[-1][0]] += sizes[address]
