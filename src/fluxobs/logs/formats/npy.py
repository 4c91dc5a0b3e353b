"""NumPy .npy files: a structured array, or a matrix with one column per channel."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import RecordError
from .nested import Contents, field_of, line_of, tables
from .table import Table


class _MappedArray:
    """Array in a file, mapped again for every read, because a map keeps all pages once read."""

    def __init__(self, path: Path, array: np.ndarray[Any, Any]) -> None:
        self.path, self.shape, self.dtype = path, array.shape, array.dtype

    def __len__(self) -> int:
        return int(self.shape[0])

    def __getitem__(self, rows: Any) -> Any:
        return np.array(np.load(self.path, mmap_mode="r", allow_pickle=False)[rows])


def numbers_of(kind: np.dtype[Any]) -> np.dtype[Any]:
    """Return a type with only the fields that hold one number or one time stamp per row."""
    names = [name for name in kind.names or () if kind[name].kind in "fiubMm"]
    return kind[names] if kind.names else kind


def open_npy(path: Path, header: list[str] | None = None) -> list[Table]:
    """Open the table of an array, which stays in its file."""
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as error:  # NumPy raises many kinds of errors for a broken header
        raise RecordError(f"{path}: not a readable .npy file: {error}") from None
    contents = Contents()
    if array.dtype.names:
        rows = _MappedArray(path, array)
        for name in numbers_of(array.dtype).names or ():
            contents.columns[name] = (len(rows), field_of(rows, name))
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
            contents.columns[name] = (max(array.shape), line_of(rows, axis, n))
    else:
        raise RecordError(f"{path}: its array has shape {array.shape}, not rows and columns")
    return tables(path, contents)
