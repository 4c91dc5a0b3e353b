"""NumPy .npz archives: one array per column, or matrices with several columns."""

from __future__ import annotations

import math
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy

from ...core.input_files import most_unpacked
from ...errors import RecordError
from .nested import Contents, tables
from .npy import numbers_of
from .table import Table

#: Largest array [bytes], which is unpacked into memory: a thousand million rows.
LARGEST = 1 << 33
#: Readers of array headers, by format version.
_HEADS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


class _Member:
    """Array of an archive, unpacked at the first read, because most arrays are not needed."""

    def __init__(self, path: Path, archive: zipfile.ZipFile, name: str) -> None:
        self._path, self._name = path, name
        self._array: np.ndarray[Any, Any] | None = None
        with archive.open(name) as file:
            version = npy.read_magic(file)
            if version in _HEADS:
                self.shape, _, self.dtype = _HEADS[version](file)
        if version not in _HEADS:  # headers of version 3 may have field names in other scripts
            array = self[...]
            self.shape, self.dtype = array.shape, array.dtype
        if math.prod(self.shape) * self.dtype.itemsize > LARGEST:
            raise ValueError(f"its array {name} of shape {self.shape} is too large for memory")

    def __len__(self) -> int:
        return int(self.shape[0])

    def __getitem__(self, rows: Any) -> Any:
        if self._array is None:
            try:
                with zipfile.ZipFile(self._path) as archive, archive.open(self._name) as file:
                    self._array = npy.read_array(file, allow_pickle=False)
            except (zlib.error, zipfile.BadZipFile, EOFError, MemoryError) as error:
                raise ValueError(f"{self._name}: {error}") from None
        return self._array[rows]


def open_npz(path: Path) -> list[Table]:
    """Open the tables of an archive; objects and texts in it are ignored."""
    contents = Contents()
    try:
        with zipfile.ZipFile(path) as archive:
            size, limit = (
                sum(info.file_size for info in archive.infolist()),
                most_unpacked(path),
            )
            if size > limit:
                raise ValueError(f"it unpacks to {size} bytes, more than {limit}; use numpy.savez")
            for name in archive.namelist():
                if not name.endswith(".npy"):
                    continue
                member = _Member(path, archive, name)
                if not member.dtype.hasobject:
                    member.dtype = numbers_of(member.dtype)
                    contents.add(name.removesuffix(".npy"), member)
    except Exception as error:  # zipfile, zlib and NumPy raise many kinds of errors
        raise RecordError(f"{path}: not a readable .npz file: {error}") from None
    return tables(path, contents)
