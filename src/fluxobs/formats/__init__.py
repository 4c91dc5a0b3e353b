"""Readers: files of columns, whatever their format."""

from __future__ import annotations

from pathlib import Path

from ..errors import RecordError
from .table import BATCH, Table, missing_column, read_rows

__all__ = ["BATCH", "Table", "missing_column", "open_table", "read_rows"]


def open_table(path: str | Path) -> Table:
    """Table in a file: .parquet, .npz, else delimited text.

    Raises
    ------
    RecordError
        The file is missing, unreadable or empty.
    """
    path = Path(path)
    if path.is_dir():
        raise RecordError(f"{path}: this is a folder, not a log")
    if not path.exists():
        raise RecordError(f"{path}: no such file")
    # A format's library is loaded only where it is needed: start-up time counts.
    match path.suffix.lower():
        case ".npz":
            from .npz import NpzTable

            table: Table = NpzTable(path)
        case ".parquet" | ".pq":
            from .parquet import ParquetTable

            table = ParquetTable(path)
        case _:
            from .text import TextTable

            table = TextTable(path)
    if not table.columns:
        raise RecordError(f"{path}: no columns of numbers in it")
    return table
