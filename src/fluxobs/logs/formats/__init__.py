"""Readers for files of columns, in every supported format."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from ...errors import RecordError
from .table import BATCH, Table, missing_column, read_rows

#: Endings of files that are not text, each with its module and class. They are loaded when needed:
#: start-up time counts. A new format is a class with the members of :class:`Table` and a line here.
FORMATS = {
    ".npz": ("npz", "NpzTable"),
    ".parquet": ("parquet", "ParquetTable"),
    ".pq": ("parquet", "ParquetTable"),
}
TEXT = ("text", "TextTable")

__all__ = ["BATCH", "Table", "missing_column", "open_table", "read_rows"]


def open_table(path: str | Path) -> Table:
    """Open the table in a file: .parquet, .npz, else delimited text.

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
    module, name = FORMATS.get(path.suffix.lower(), TEXT)
    table: Table = getattr(import_module(f"{__name__}.{module}"), name)(path)
    if not table.columns:
        raise RecordError(f"{path}: it has no columns of numbers")
    return table
