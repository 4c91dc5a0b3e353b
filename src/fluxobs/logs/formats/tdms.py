"""TDMS files (National Instruments), read with npTDMS: channels of one table share their times."""

from __future__ import annotations

import weakref
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...core.arrays import Array
from ...errors import RecordError
from .extras import library
from .table import BATCH, Columns, Said, Table


class TdmsTable(Table):
    """Channels with the same length, rate and start."""

    def __init__(self, path: Path, channels: dict[str, Any], file: Any) -> None:
        self.path, self._file = path, file
        self._channels = channels
        self.columns = list(channels)
        first = next(iter(channels.values()))
        self.rows = len(first)
        units = {
            name: str(channel.properties["unit_string"])
            for name, channel in channels.items()
            if channel.properties.get("unit_string")
        }
        increment = first.properties.get("wf_increment")
        start = float(first.properties.get("wf_start_offset", 0.0))
        self.said = Said(units, None, float(increment) if increment else None, start)

    def batches(
        self, names: Sequence[str], first: int, last: int, size: int = BATCH
    ) -> Iterator[Columns]:
        for start in range(first, last, size):
            try:
                yield {n: self._values(n, start, min(size, last - start)) for n in names}
            except Exception as error:  # npTDMS raises many kinds of errors for a broken file
                raise RecordError(f"{self.path}: reading failed midway: {error}") from None

    def _values(self, name: str, start: int, count: int) -> Array:
        values = self._channels[name].read_data(start, count)
        if values.dtype.kind == "M":  # convert stamps to seconds since the first stamp
            origin = self._channels[name].read_data(0, 1)[0]
            values = (values - origin) / np.timedelta64(1, "s")
        if len(values) < count:
            raise ValueError(f"{name} ends before its {self.rows} values")
        return np.asarray(values, dtype=float)


def open_tdms(path: Path) -> list[Table]:
    """Open the tables of numeric channels, named "group/channel" if there are several groups."""
    nptdms = library("nptdms", "tdms", path)
    try:
        handle = path.open("rb")
    except OSError as error:
        raise RecordError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        file = nptdms.TdmsFile.open(handle)
    except Exception as error:  # npTDMS raises many kinds of errors for a broken file
        handle.close()
        raise RecordError(f"{path}: not a readable TDMS file: {error}") from None
    weakref.finalize(file, handle.close)
    groups = [group for group in file.groups() if any(map(len, group.channels()))]
    tables: dict[tuple[Any, ...], dict[str, Any]] = defaultdict(dict)
    for group in groups:
        prefix = f"{group.name}/" if len(groups) > 1 else ""
        for channel in group.channels():
            kind = np.dtype(channel.dtype).kind if channel.dtype is not None else ""
            if len(channel) == 0 or kind not in "fiubM":
                continue
            properties = channel.properties
            timing = (properties.get("wf_increment"), properties.get("wf_start_offset"))
            group_key = group.name if not timing[0] else ""
            tables[(len(channel), *timing, group_key)][f"{prefix}{channel.name}"] = channel
    return [TdmsTable(path, channels, file) for channels in tables.values()]
