"""MDF (ASAM), by asammdf: a table for each channel group, whose channels share their time."""

from __future__ import annotations

import weakref
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import RecordError
from .extras import library
from .formula import is_arithmetic
from .table import BATCH, Columns, Said, Table

#: Data types of numbers: integers and floats in both byte orders.
_NUMBERS = range(6)
#: Largest data block that is read at once [bytes].
BLOCK = 1 << 22


class MdfTable(Table):
    """A channel group."""

    def __init__(self, path: Path, mdf: Any, group: int, prefix: str) -> None:
        self.path = path
        self._mdf, self._group = mdf, group
        content = mdf.groups[group]
        self.rows = int(content.channel_group.cycles_nr)
        self._index: dict[str, int] = {}
        units: dict[str, str] = {}
        master = mdf.masters_db.get(group)
        time = None
        for n, channel in enumerate(content.channels):
            if channel.data_type not in _NUMBERS:
                continue
            name = f"{prefix}{channel.name}"
            if name in self._index:
                name = f"{name} {n}"
            self._index[name] = n
            unit = channel.unit or ("s" if n == master else "")
            if unit:
                units[name] = unit
            if n == master:
                time = name
        self.columns = list(self._index)
        self.said = Said(units, time)

    def batches(
        self, names: Sequence[str], first: int, last: int, size: int = BATCH
    ) -> Iterator[Columns]:
        channels = [(None, self._group, self._index[name]) for name in names]
        for name in names:
            self._check(name)
        for start in range(first, last, size):
            try:
                parts = self._mdf.select(
                    channels,
                    record_offset=start,
                    record_count=min(size, last - start),
                    copy_master=False,
                )
                yield {
                    name: np.asarray(part.samples, dtype=float)
                    for name, part in zip(names, parts, strict=True)
                }
            except (ValueError, TypeError) as error:
                raise RecordError(
                    f"{self.path}: a channel of {', '.join(names)} holds no numbers: {error}"
                ) from None
            except Exception as error:  # asammdf raises many kinds for broken blocks
                raise RecordError(f"{self.path}: damaged: {error!r}") from None

    def _check(self, name: str) -> None:
        """Raise RecordError if asammdf would have code evaluated for the channel."""
        channel = self._mdf.groups[self._group].channels[self._index[name]]
        for formula in _formulas(channel.conversion):
            if not is_arithmetic(formula):
                raise RecordError(
                    f"{self.path}: channel {name} is converted by the formula {formula[:80]!r}, "
                    f"which is not arithmetic of X1 alone; write its values without a formula"
                )


def _formulas(conversion: Any) -> Iterator[str]:
    """The formulas of a conversion, and of those that it refers to, be it in a circle."""
    left, seen = [conversion], set[int]()
    while left:
        one = left.pop()
        if id(one) in seen:
            continue
        seen.add(id(one))
        formula = getattr(one, "formula", None)
        if formula:
            yield formula.decode("latin-1") if isinstance(formula, bytes) else str(formula)
        left += (getattr(one, "referenced_blocks", None) or {}).values()


def _split(group: Any) -> None:
    """Cut large uncompressed data blocks of a group into small ones: a block is read as a whole,
    for every batch that is in it."""
    blocks = list(group.get_data_blocks())
    small = []
    for info in blocks:
        size = info.original_size or 0
        plain = not (info.block_type or info.invalidation_block or info.block_limit)
        if not plain or size <= BLOCK or info.compressed_size != size:
            small.append(info)
            continue
        for start in range(0, size, BLOCK):
            part = min(BLOCK, size - start)
            small.append(type(info)(info.address + start, 0, part, part, 0))
    if len(small) > len(blocks):
        group.set_blocks_info(small)


def open_mdf(path: Path) -> list[Table]:
    """Tables of the channel groups that have rows."""
    asammdf = library("asammdf", "mdf", path)
    try:
        # by its name the whole file would be read for every batch
        handle = path.open("rb")
    except OSError as error:
        raise RecordError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        mdf = asammdf.MDF(handle)
    except Exception as error:  # asammdf raises many kinds for a broken file
        handle.close()
        raise RecordError(f"{path}: not a readable MDF file: {error}") from None
    weakref.finalize(mdf, handle.close)
    groups = [n for n, group in enumerate(mdf.groups) if group.channel_group.cycles_nr]
    for n in groups:
        _split(mdf.groups[n])
    if len(groups) == 1:
        return [MdfTable(path, mdf, groups[0], "")]
    names = [mdf.groups[n].channel_group.acq_name for n in groups]
    return [
        MdfTable(path, mdf, n, f"{name if name and names.count(name) == 1 else f'group {n}'}/")
        for n, name in zip(groups, names, strict=True)
    ]
