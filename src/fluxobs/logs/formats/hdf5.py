"""HDF5, and MATLAB files of version 7.3, which are HDF5 as well."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from ...core.input_files import BLOCK, PACKED_BLOCK, check_deflated, most_unpacked
from ...errors import RecordError
from .extras import library
from .nested import Contents, tables
from .table import Table

#: MATLAB's own group, which holds what others refer to.
_REFERENCES = "#refs#"
#: Filters that do not compress, or not to less than the values need: shuffle, checksum, n bits.
_DEFLATE, _PLAIN = 1, (2, 3, 5, 6)


class _Dataset:
    """A dataset, examined before its values are unpacked for the first time."""

    def __init__(self, h5py: Any, file: Any, data: Any, most: int) -> None:
        self.shape, self.dtype = data.shape, data.dtype
        self._chunk = math.prod(data.chunks) * self.dtype.itemsize if data.chunks else 0
        if PACKED_BLOCK < self._chunk <= BLOCK:  # else it is unpacked anew for every batch in it
            name = h5py.h5i.get_name(data.id)
            data.id.close()
            access = h5py.h5p.create(h5py.h5p.DATASET_ACCESS)
            access.set_chunk_cache(521, self._chunk, 1.0)
            data = h5py.Dataset(h5py.h5d.open(file.id, name, access))
        self._data, self._most, self._examined = data, most, False

    def __len__(self) -> int:
        return int(self.shape[0])

    def __getitem__(self, rows: Any) -> Any:
        if not self._examined:
            self._examine()
            self._examined = True
        return self._data[rows]

    def _examine(self) -> None:
        """Raise ValueError if more comes out of it than it says, or far more than its file has."""
        size = math.prod(self.shape) * self.dtype.itemsize
        if size > self._most:
            raise ValueError(f"{self._data.name} unpacks to {size} bytes, more than {self._most}")
        if not self._chunk:
            return
        if self._chunk > BLOCK:
            raise ValueError(
                f"{self._data.name} has chunks of {self._chunk} bytes, which are unpacked as a "
                f"whole; write it with smaller ones"
            )
        created = self._data.id.get_create_plist()
        filters = [created.get_filter(n)[0] for n in range(created.get_nfilters())]
        if len([one for one in filters if one not in _PLAIN]) > 1:
            raise ValueError(f"{self._data.name} is compressed twice")
        large: list[Any] = []
        self._data.id.chunk_iter(lambda one: large.append(one) if one.size > PACKED_BLOCK else None)
        if _DEFLATE in filters:
            for one in large:
                _, packed = self._data.id.read_direct_chunk(one.chunk_offset)
                check_deflated(packed, self._chunk, f"a chunk of {self._data.name}")


def open_hdf5(path: Path, extra: str = "hdf5") -> list[Table]:
    """Tables of the datasets of a file; a dataset in a group has the path "group/dataset"."""
    h5py = library("h5py", extra, path)
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise RecordError(f"{path}: not a readable HDF5 file: {error}") from None
    found = Contents()
    most = most_unpacked(path)

    def visit(name: str | bytes, node: Any) -> None:
        if isinstance(name, bytes):  # no UTF-8
            name = name.decode("utf-8", errors="replace")
        if isinstance(node, h5py.Dataset) and not name.startswith(_REFERENCES) and node.shape:
            if node.is_virtual or node.external:
                raise RecordError(
                    f"{path}: the values of {name} are kept in other files, which are "
                    f"not read for a log; copy them into this one"
                )
            unit = next((node.attrs[k] for k in ("unit", "units", "Unit") if k in node.attrs), None)
            if isinstance(unit, bytes):
                unit = unit.decode("utf-8", errors="replace")
            found.add(name, _Dataset(h5py, file, node, most), None if unit is None else str(unit))

    try:
        file.visititems(visit)
    except RecordError:
        raise
    except Exception as error:  # h5py raises many kinds for a broken file
        raise RecordError(f"{path}: damaged: {error}") from None
    return tables(path, found)
