"""MDF files (ASAM), read with asammdf: one table per channel group, whose channels share times."""

from __future__ import annotations

import weakref
import zlib
from collections.abc import Iterator, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from ...core.input_files import most_unpacked
from ...errors import RecordError
from .extras import library
from .formula import is_arithmetic
from .mdf_blocks import check_blocks, check_packed
from .table import BATCH, Columns, Said, Table

#: Numeric data types: integers and floats in both byte orders.
_NUMBERS = range(6)
#: Types of data blocks compressed by zlib: without and with transposition.
_DEFLATED = (1, 2)
#: Largest data block read at once [bytes].
BLOCK = 1 << 22


class MdfTable(Table):
    """Channel group of an MDF file."""

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
        self._examined = False

    def _check_size(self) -> None:
        """Raise ValueError if the rows need far more memory than the file."""
        group = self._mdf.groups[self._group]
        size = self.rows * max(1, group.channel_group.samples_byte_nr)
        limit = most_unpacked(self.path)
        if size > limit:
            raise ValueError(f"its rows have {size} bytes, more than {limit}")
        check_packed(
            self.path,
            (
                (block.address, block.compressed_size if block.block_type in _DEFLATED else 0, size)
                for block in group.get_data_blocks()
                if block.block_type and (size := block.original_size or 0)
            ),
        )

    def batches(
        self, names: Sequence[str], first: int, last: int, size: int = BATCH
    ) -> Iterator[Columns]:
        channels = [(None, self._group, self._index[name]) for name in names]
        try:
            if not self._examined:
                self._check_size()
        except (ValueError, zlib.error) as error:
            raise RecordError(f"{self.path}: damaged: {error}") from None
        self._examined = True
        for start in range(first, last, size):
            try:
                signals = self._mdf.select(
                    channels,
                    record_offset=start,
                    record_count=min(size, last - start),
                    copy_master=False,
                )
                yield {
                    name: np.asarray(signal.samples, dtype=float)
                    for name, signal in zip(names, signals, strict=True)
                }
            except (ValueError, TypeError) as error:
                raise RecordError(
                    f"{self.path}: a channel of {', '.join(names)} holds no numbers: {error}"
                ) from None
            except Exception as error:  # asammdf raises many kinds of errors for broken blocks
                raise RecordError(f"{self.path}: damaged: {error!r}") from None


def _check_formulas(path: Path, mdf: Any) -> None:
    """Raise RecordError if a conversion in the file has a formula that is not arithmetic.

    asammdf evaluates formulas as code. It converts more than the requested channels: the time of
    the channel group, members of structures, axes of arrays. Therefore the whole file is checked.
    """
    for group in mdf.groups:
        dependencies = getattr(group, "channel_dependencies", None) or ()
        for channel, arrays in zip_longest(group.channels, dependencies):
            _check_conversion(path, channel.name, channel.conversion)
            for array in arrays if isinstance(arrays, list | tuple) else ():  # arrays of MDF 4
                for n in range(getattr(array, "dims_nr", 0)):
                    axis = getattr(array, f"axis_conversion_{n}", None)
                    _check_conversion(path, f"{channel.name}, axis {n},", axis)


def _check_conversion(path: Path, name: str, conversion: Any) -> None:
    for formula in _formulas(conversion):
        if not is_arithmetic(formula):
            raise RecordError(
                f"{path}: channel {name} is converted by the formula {formula[:80]!r}, but only "
                f"short arithmetic of X1 is allowed. Export the channel without a formula"
            )


def _formulas(conversion: Any) -> Iterator[str]:
    """Yield the formulas of a conversion and of its referenced conversions, even if circular."""
    pending, seen = [conversion], set[int]()
    while pending:
        block = pending.pop()
        if id(block) in seen:
            continue
        seen.add(id(block))
        formula = getattr(block, "formula", None)
        if formula:
            yield formula.decode("latin-1") if isinstance(formula, bytes) else str(formula)
        pending += (getattr(block, "referenced_blocks", None) or {}).values()


def _split_blocks(group: Any) -> None:
    """Split large uncompressed data blocks of a group, because each batch reads whole blocks."""
    blocks = list(group.get_data_blocks())
    pieces = []
    for info in blocks:
        size = info.original_size or 0
        plain = not (info.block_type or info.invalidation_block or info.block_limit)
        if not plain or size <= BLOCK or info.compressed_size != size:
            pieces.append(info)
            continue
        for start in range(0, size, BLOCK):
            length = min(BLOCK, size - start)
            pieces.append(
                type(info)(info.address + start, info.block_type, length, length, info.param)
            )
    if len(pieces) > len(blocks):
        group.set_blocks_info(pieces)


def open_mdf(path: Path) -> list[Table]:
    """Open the tables of the channel groups that have rows."""
    asammdf = library("asammdf", "mdf", path)
    try:
        check_blocks(path)
        # if asammdf got a name, it would read the whole file for every batch
        handle = path.open("rb")
    except OSError as error:
        raise RecordError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise RecordError(f"{path}: not a readable MDF file: {error}") from None
    try:
        # bus frames are not needed, and asammdf would convert them before they are checked
        mdf = asammdf.MDF(handle, process_bus_logging=False)
    except Exception as error:  # asammdf raises many kinds of errors for a broken file
        handle.close()
        raise RecordError(f"{path}: not a readable MDF file: {error}") from None
    weakref.finalize(mdf, handle.close)
    _check_formulas(path, mdf)
    groups = [n for n, group in enumerate(mdf.groups) if group.channel_group.cycles_nr]
    for n in groups:
        _split_blocks(mdf.groups[n])
    if len(groups) == 1:
        return [MdfTable(path, mdf, groups[0], "")]
    names = [mdf.groups[n].channel_group.acq_name for n in groups]
    return [
        MdfTable(path, mdf, n, f"{name if name and names.count(name) == 1 else f'group {n}'}/")
        for n, name in zip(groups, names, strict=True)
    ]
