"""NumPy arrays in one file: a structured array, or a matrix with a column a channel."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...errors import RecordError
from .nested import Found, tables
from .table import Table


def open_npy(path: Path, header: list[str] | None = None) -> list[Table]:
    """The table of an array, which stays in its file."""
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, EOFError, ValueError) as error:
        raise RecordError(f"{path}: not a readable .npy file: {error}") from None
    found = Found()
    if array.dtype.names:
        for name in array.dtype.names:
            found.add(name, array[name])
    elif array.ndim == 2:
        width = min(array.shape)
        if header is None:
            raise RecordError(
                f"{path}: a matrix of {width} columns has no names; give them with "
                f'--header "t,u_a,…"'
            )
        if len(header) != width:
            raise RecordError(f"{path}: --header has {len(header)} names for {width} columns")
        columns = array if array.shape[1] == width else array.T
        for n, name in enumerate(header):
            found.add(name, columns[:, n])
    else:
        raise RecordError(f"{path}: its array has shape {array.shape}, not rows and columns")
    return tables(path, found)
