"""NumPy arrays in one file: a structured array, or a matrix with a column a channel."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import RecordError
from .nested import Contents, field_of, line_of, tables
from .table import Table


class _MappedArray:
    """An array in a file, mapped anew for every look: a map keeps all that it has touched."""

    def __init__(self, path: Path, array: np.ndarray[Any, Any]) -> None:
        self.path, self.shape, self.dtype = path, array.shape, array.dtype

    def __len__(self) -> int:
        return int(self.shape[0])

    def __getitem__(self, rows: Any) -> Any:
        return np.array(np.load(self.path, mmap_mode="r", allow_pickle=False)[rows])


def numbers_of(kind: np.dtype[Any]) -> np.dtype[Any]:
    """A type without its fields that hold no number or stamp a row."""
    names = [name for name in kind.names or () if kind[name].kind in "fiubMm"]
    return kind[names] if kind.names else kind


def open_npy(path: Path, header: list[str] | None = None) -> list[Table]:
    """The table of an array, which stays in its file."""
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as error:  # NumPy raises many kinds for a broken head, even SyntaxError
        raise RecordError(f"{path}: not a readable .npy file: {error}") from None
    found = Contents()
    if array.dtype.names:
        rows = _MappedArray(path, array)
        for name in numbers_of(array.dtype).names or ():
            found.columns[name] = (len(rows), field_of(rows, name))
    elif array.ndim == 2:
        width = min(array.shape)
        if header is None:
            raise RecordError(
                f"{path}: a matrix of {width} columns has no names; give them with "
                f'--header "t,u_a,…"'
            )
        if len(header) != width:
            raise RecordError(f"{path}: --header has {len(header)} names for {width} columns")
        rows, axis = _MappedArray(path, array), int(array.shape[1] != width)
        for n, name in enumerate(header):
            found.columns[name] = (max(array.shape), line_of(rows, axis, n))
    else:
        raise RecordError(f"{path}: its array has shape {array.shape}, not rows and columns")
    return tables(path, found)
