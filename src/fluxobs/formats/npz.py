"""NumPy archives: one array a column."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ..errors import RecordError
from .table import BATCH, Columns


class NpzTable:
    """Equally long one-dimensional arrays of an .npz file; anything else in it is passed over."""

    random_access = True

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            with np.load(path, allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
        except (OSError, EOFError, ValueError, zipfile.BadZipFile) as error:
            raise RecordError(f"{path}: not a readable .npz file: {error}") from None
        self._arrays = {
            name: array.astype(float)
            for name, array in arrays.items()
            if array.ndim == 1 and array.dtype.kind in "fiub"
        }
        self.columns = list(self._arrays)
        lengths = {len(array) for array in self._arrays.values()}
        if len(lengths) > 1:
            sizes = ", ".join(f"{name} {len(array)}" for name, array in self._arrays.items())
            raise RecordError(f"{path}: the arrays differ in length: {sizes}")
        self.rows = lengths.pop() if lengths else 0

    def batches(
        self, names: Sequence[str], first: int, last: int, size: int = BATCH
    ) -> Iterator[Columns]:
        for start in range(first, last, size):
            stop = min(start + size, last)
            yield {name: self._arrays[name][start:stop] for name in names}

    def place(self, row: int) -> str:
        return f"row {row + 1}"
