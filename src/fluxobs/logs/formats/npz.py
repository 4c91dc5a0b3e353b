"""NumPy archives: one array per column."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from ...errors import RecordError
from .arrays import ArrayTable


class NpzTable(ArrayTable):
    """Equally long one-dimensional arrays of an .npz file; anything else in it is ignored."""

    def __init__(self, path: Path) -> None:
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
        super().__init__(numbers, path)
