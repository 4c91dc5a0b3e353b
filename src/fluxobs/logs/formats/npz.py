"""NumPy archives: one array per column."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from ...errors import RecordError
from .arrays import ArrayTable
from .table import Table


def open_npz(path: Path) -> list[Table]:
    """Equally long one-dimensional arrays of an .npz file; anything else in it is ignored."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except (OSError, EOFError, ValueError, zipfile.BadZipFile) as error:
        raise RecordError(f"{path}: not a readable .npz file: {error}") from None
    numbers = {
        name: array
        for name, array in arrays.items()
        if array.ndim == 1 and array.dtype.kind in "fiub"
    }
    return [ArrayTable(numbers, path)]
