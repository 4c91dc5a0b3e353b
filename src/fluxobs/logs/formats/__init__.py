"""Readers of column files in all supported formats."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from ...core.forks import use_polars
from ...core.input_files import check_regular
from ...errors import RecordError
from .table import BATCH, Said, Table, missing_column, read_rows

#: Endings of files that are not text. Each ending has a module and a function, which are loaded on
#: demand to keep start-up short. A new format needs a line here, and a function that returns the
#: tables of a file: one table for each set of columns that share their times.
FORMATS = {
    ".npz": ("npz", "open_npz"),
    ".npy": ("npy", "open_npy"),
    ".parquet": ("polars_files", "open_parquet"),
    ".pq": ("polars_files", "open_parquet"),
    ".feather": ("polars_files", "open_arrow"),
    ".arrow": ("polars_files", "open_arrow"),
    ".ipc": ("polars_files", "open_arrow"),
    ".json": ("polars_files", "open_json"),
    ".jsonl": ("polars_files", "open_json_lines"),
    ".ndjson": ("polars_files", "open_json_lines"),
    ".mf4": ("mdf", "open_mdf"),
    ".mdf": ("mdf", "open_mdf"),
    ".dat": ("mdf", "open_mdf"),
    ".mat": ("mat", "open_mat"),
    ".h5": ("hdf5", "open_hdf5"),
    ".hdf5": ("hdf5", "open_hdf5"),
    ".hdf": ("hdf5", "open_hdf5"),
    ".tdms": ("tdms", "open_tdms"),
    ".ulg": ("ulog", "open_ulog"),
    ".xlsx": ("excel", "open_excel"),
    ".xlsm": ("excel", "open_excel"),
    ".xls": ("excel", "open_excel"),
    ".ods": ("excel", "open_excel"),
}
#: Openers of formats whose columns may lack names.
_NAMELESS = ("open_npy", "open_excel")
#: First bytes of a file → format of the file. The first bytes decide if the ending is unknown.
_MAGIC = {b"MDF     ": ".mf4", b"UnFinMF ": ".mf4", b"\x89HDF\r\n": ".h5", b"PAR1": ".parquet"}

__all__ = ["BATCH", "Said", "Table", "missing_column", "open_tables", "read_rows"]


def open_tables(path: str | Path, header: list[str] | None = None) -> list[Table]:
    """Open the tables in a file. The file's ending selects the format; the default is text.

    Parameters
    ----------
    path : path
    header : list of str, optional
        Names of the columns, for text or arrays without names.

    Raises
    ------
    RecordError
        The file is missing, unreadable or empty, or its library is not installed.
    UsageError
        The process was forked after it had read a file.
    """
    use_polars()
    path = Path(path)
    if path.is_dir():
        raise RecordError(f"{path}: this is a folder, not a log")
    if not path.exists():
        raise RecordError(f"{path}: no such file")
    check_regular(path, RecordError)
    module, opener = _format(path)
    if opener is None:
        from .text import TextTable

        tables: list[Table] = [TextTable(path, header)]
    else:
        options = {"header": header} if opener in _NAMELESS else {}
        tables = getattr(import_module(f"{__name__}.{module}"), opener)(path, **options)
    tables = [table for table in tables if table.columns]
    if not tables:
        raise RecordError(f"{path}: it has no columns of numbers")
    return tables


def _format(path: Path) -> tuple[str, str | None]:
    ending = path.suffix.lower()
    with path.open("rb") as file:
        first_bytes = file.read(8)
    detected = next((name for head, name in _MAGIC.items() if first_bytes.startswith(head)), None)
    if ending == ".dat" and detected is None:  # the ending .dat is used for text and for MDF
        return "text", None
    if ending not in FORMATS and detected is not None:
        ending = detected
    return FORMATS.get(ending, ("text", None))
