"""Parquet."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import polars as pl

from ...errors import RecordError
from .lazy import as_columns, frames
from .table import BATCH, Columns


class ParquetTable:
    """Columns of a Parquet file."""

    random_access = True

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._lazy = pl.scan_parquet(path)
            self._schema = self._lazy.collect_schema()
            self.rows = int(self._lazy.select(pl.len()).collect().item())
        except (pl.exceptions.PolarsError, OSError) as error:
            raise RecordError(f"{path}: not a readable Parquet file: {error}") from None
        self.columns = list(self._schema.names())

    def batches(
        self, names: Sequence[str], first: int, last: int, size: int = BATCH
    ) -> Iterator[Columns]:
        for name in names:
            if not self._schema[name].is_numeric():
                raise RecordError(
                    f"{self.path}: column {name!r} holds {self._schema[name]}, not numbers"
                )
        try:
            for frame in frames(self._lazy, names, first, last, size):
                yield as_columns(frame)
        except pl.exceptions.PolarsError as error:
            raise RecordError(f"{self.path}: reading failed midway: {error}") from None

    def place(self, row: int) -> str:
        return f"row {row + 1}"
