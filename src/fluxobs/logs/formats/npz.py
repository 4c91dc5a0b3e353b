"""NumPy archives: an array a column, or a matrix with several."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...errors import RecordError
from .nested import Found, tables
from .table import Table


def open_npz(path: Path) -> list[Table]:
    """The tables of an archive; objects and texts in it are ignored."""
    found = Found()
    try:
        with np.load(path, allow_pickle=False) as archive:
            for name in archive.files:
                try:
                    array = archive[name]
                except ValueError:  # Python objects
                    continue
                found.add(name, array)
    except Exception as error:  # zipfile, zlib and NumPy raise many kinds for a broken file
        raise RecordError(f"{path}: not a readable .npz file: {error}") from None
    return tables(path, found)
