"""HDF5 files, including MATLAB files of version 7.3."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

from ...core.input_files import BLOCK, PACKED_BLOCK, check_deflated, most_unpacked
from ...errors import RecordError
from .extras import library
from .nested import Contents, tables
from .table import Table

#: MATLAB's group of referenced objects.
_REFERENCES = "#refs#"
#: MATLAB's group of the values of objects, and the attribute of a variable with its class.
_SUBSYSTEM, _CLASS = "#subsystem#", "MATLAB_class"
#: Classes whose variables are objects.
_OBJECTS = ("timeseries", "timetable", "table", "tscollection", "Simulink.SimulationOutput")
#: Groups and data sets of a log, and depth to which they are nested. The library takes a third of a
#: millisecond for a node, and a time that grows with the square of the depth.
_MOST_NODES, _DEEPEST = 10_000, 32
#: Code of deflate, and codes of filters that do not compress beyond the content of the data:
#: shuffle, checksum, n bits.
_DEFLATE, _PLAIN = 1, (2, 3, 5, 6)


class _Dataset:
    """Dataset; its size is checked before the first values are unpacked."""

    def __init__(self, h5py: Any, file: Any, data: Any, limit: int) -> None:
        self.shape, self.dtype = data.shape, data.dtype
        self._chunk = math.prod(data.chunks) * self.dtype.itemsize if data.chunks else 0
        if (
            PACKED_BLOCK < self._chunk <= BLOCK
        ):  # without a cache, every batch unpacks the chunk again
            name = h5py.h5i.get_name(data.id)
            data.id.close()
            access = h5py.h5p.create(h5py.h5p.DATASET_ACCESS)
            access.set_chunk_cache(521, self._chunk, 1.0)
            data = h5py.Dataset(h5py.h5d.open(file.id, name, access))
        self._data, self._limit, self._examined = data, limit, False

    def __len__(self) -> int:
        return int(self.shape[0])

    def __getitem__(self, rows: Any) -> Any:
        if not self._examined:
            self._check_size()
            self._examined = True
        return self._data[rows]

    def _check_size(self) -> None:
        """Raise ValueError if the dataset is larger than declared, or far larger than the file."""
        size = math.prod(self.shape) * self.dtype.itemsize
        if size > self._limit:
            raise ValueError(f"{self._data.name} unpacks to {size} bytes, more than {self._limit}")
        if not self._chunk:
            return
        if self._chunk > BLOCK:
            raise ValueError(
                f"{self._data.name} has chunks of {self._chunk} bytes, which are unpacked as a "
                f"whole; write it with smaller chunks"
            )
        properties = self._data.id.get_create_plist()
        filters = [properties.get_filter(n)[0] for n in range(properties.get_nfilters())]
        if len([code for code in filters if code not in _PLAIN]) > 1:
            raise ValueError(f"{self._data.name} is compressed twice")
        large: list[Any] = []
        self._data.id.chunk_iter(
            lambda chunk: large.append(chunk) if chunk.size > PACKED_BLOCK else None
        )
        if _DEFLATE in filters:
            for chunk in large:
                _, packed = self._data.id.read_direct_chunk(chunk.chunk_offset)
                check_deflated(packed, self._chunk, f"a chunk of {self._data.name}")


def open_hdf5(path: Path, extra: str = "hdf5") -> list[Table]:
    """Open the tables of the datasets; a dataset in a group has the path "group/dataset"."""
    h5py = library("h5py", extra, path)
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise RecordError(f"{path}: not a readable HDF5 file: {error}") from None
    contents = Contents()
    objects: dict[str, str] = {}
    limit, count = most_unpacked(path), itertools.count(1)

    def visit(name: str | bytes, node: Any) -> None:
        if isinstance(name, bytes):  # not UTF-8
            name = name.decode("utf-8", errors="replace")
        excess = None
        if next(count) > _MOST_NODES:
            excess = f"more than {_MOST_NODES} groups and data sets"
        elif name.count("/") >= _DEEPEST:
            excess = f"groups are nested more than {_DEEPEST} deep"
        if excess:
            raise RecordError(f"{path}: {excess}; save the log's signals in a separate file")
        if name.startswith((_REFERENCES, _SUBSYSTEM)):
            return
        kind = node.attrs.get(_CLASS, b"")
        kind = kind.decode("utf-8", errors="replace") if isinstance(kind, bytes) else str(kind)
        if kind in _OBJECTS or "MATLAB_object_decode" in node.attrs:
            objects[name] = kind
            return
        if isinstance(node, h5py.Dataset) and node.shape:
            if node.is_virtual or node.external:
                raise RecordError(
                    f"{path}: the values of {name} are kept in other files, which are not read; "
                    f"copy the values into this file"
                )
            unit = next(
                (node.attrs[key] for key in ("unit", "units", "Unit") if key in node.attrs), None
            )
            if isinstance(unit, bytes):
                unit = unit.decode("utf-8", errors="replace")
            contents.add(
                name, _Dataset(h5py, file, node, limit), None if unit is None else str(unit)
            )

    try:
        file.visititems(visit)
    except RecordError:
        raise
    except Exception as error:  # h5py raises many kinds of errors for a broken file
        raise RecordError(f"{path}: damaged: {error}") from None
    if objects and not contents.columns:
        raise RecordError(objects_of_matlab(path, objects))
    return tables(path, contents)


def objects_of_matlab(path: Path, objects: dict[str, str]) -> str:
    """Return the message on a file with objects of MATLAB: name → class, if known."""
    names = ", ".join(f"{name} ({kind})" if kind else name for name, kind in objects.items())
    held = f"{names}: objects of a MATLAB class" if names else "objects of a MATLAB class"
    return (
        f"{path}: the file holds {held}, such as timeseries, table or a Simulink Dataset, which "
        f"only MATLAB can read. Save arrays: s = struct; s.t = x.Time; s.i_a = x.Data (of a "
        f"table: s = table2struct(x, 'ToScalar', true)); save('log.mat', '-struct', 's')"
    )
