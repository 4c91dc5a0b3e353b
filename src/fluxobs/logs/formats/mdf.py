"""MDF (ASAM), by asammdf: a table for each channel group, whose channels share their time."""

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

#: Data types of numbers: integers and floats in both byte orders.
_NUMBERS = range(6)
#: Kinds of data blocks that zlib unpacks, the second of them transposed.
_DEFLATED = (1, 2)
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
        self._examined = False

    def _examine(self) -> None:
        """Raise ValueError if the rows would take far more memory than the file has."""
        group = self._mdf.groups[self._group]
        size, most = (
            self.rows * max(1, group.channel_group.samples_byte_nr),
            most_unpacked(self.path),
        )
        if size > most:
            raise ValueError(f"its rows have {size} bytes, more than {most}")
        check_packed(
            self.path,
            (
                (one.address, one.compressed_size if one.block_type in _DEFLATED else 0, size)
                for one in group.get_data_blocks()
                if one.block_type and (size := one.original_size or 0)
            ),
        )

    def batches(
        self, names: Sequence[str], first: int, last: int, size: int = BATCH
    ) -> Iterator[Columns]:
        channels = [(None, self._group, self._index[name]) for name in names]
        try:
            if not self._examined:
                self._examine()
        except (ValueError, zlib.error) as error:
            raise RecordError(f"{self.path}: damaged: {error}") from None
        self._examined = True
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


def _check_formulas(path: Path, mdf: Any) -> None:
    """Raise RecordError if a conversion in the file has a formula that is not arithmetic.

    asammdf has code evaluated for a formula. It converts more than the channels asked for: the
    time of their group, parts of a structure, axes of an array. So all of the file is checked.
    """
    for group in mdf.groups:
        parts = getattr(group, "channel_dependencies", None) or ()
        for channel, its in zip_longest(group.channels, parts):
            _refuse_code(path, channel.name, channel.conversion)
            for part in its if isinstance(its, list | tuple) else ():  # of MDF 4: arrays
                for n in range(getattr(part, "dims_nr", 0)):
                    axis = getattr(part, f"axis_conversion_{n}", None)
                    _refuse_code(path, f"{channel.name}, axis {n},", axis)


def _refuse_code(path: Path, name: str, conversion: Any) -> None:
    for formula in _formulas(conversion):
        if not is_arithmetic(formula):
            raise RecordError(
                f"{path}: channel {name} is converted by the formula {formula[:80]!r}, "
                f"which is not short arithmetic of X1 alone; write its values without a formula"
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
            small.append(type(info)(info.address + start, info.block_type, part, part, info.param))
    if len(small) > len(blocks):
        group.set_blocks_info(small)


def open_mdf(path: Path) -> list[Table]:
    """Tables of the channel groups that have rows."""
    asammdf = library("asammdf", "mdf", path)
    try:
        check_blocks(path)
        # by its name the whole file would be read for every batch
        handle = path.open("rb")
    except OSError as error:
        raise RecordError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise RecordError(f"{path}: not a readable MDF file: {error}") from None
    try:
        # what frames of a bus hold is not read, and would be converted before it is checked
        mdf = asammdf.MDF(handle, process_bus_logging=False)
    except Exception as error:  # asammdf raises many kinds for a broken file
        handle.close()
        raise RecordError(f"{path}: not a readable MDF file: {error}") from None
    weakref.finalize(mdf, handle.close)
    _check_formulas(path, mdf)
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
