"""Excel workbooks: each sheet is read like a text file, with its preamble and units."""

from __future__ import annotations

from pathlib import Path

import polars as pl

from ...errors import RecordError
from .arrays import ArrayTable
from .extras import library
from .isolated import read_apart
from .table import Table
from .text.structure import find_structure
from .workbook import check_cells, unpacked_size

#: Memory of the process that reads a workbook [bytes]: a base, and an amount per unpacked byte. The
#: base is enough for an .xls sheet with content only in its last cell. A cell needs 80 bytes; the
#: XML of a cell has 32 bytes.
BASE_MEMORY, MEMORY_PER_BYTE = 1 << 30, 4
#: Time limit of that process [s]: a base, and a time per byte. Ten million bytes take a second.
BASE_TIME, TIME_PER_BYTE = 60.0, 1e-6
#: Bytes of XML that correspond to one byte of an .xls file. Such a file has six bytes per cell.
XLS = 6


def open_excel(path: Path, header: list[str] | None = None) -> list[Table]:
    """Open the tables of the sheets; columns are "sheet/column" if several sheets have tables."""
    library("fastexcel", "excel", path)
    is_zip = path.suffix.lower() != ".xls"
    size = unpacked_size(path) if is_zip else XLS * path.stat().st_size
    memory, seconds = BASE_MEMORY + MEMORY_PER_BYTE * size, BASE_TIME + TIME_PER_BYTE * size
    return [*read_apart(read_sheets, path, header, memory, seconds)]


def read_sheets(path: Path, header: list[str] | None) -> list[ArrayTable]:
    """Read the tables of the sheets in this process."""
    if path.suffix.lower() != ".xls":
        check_cells(path)
    try:
        sheets = pl.read_excel(
            path,
            sheet_id=0,
            has_header=False,
            infer_schema_length=0,
            drop_empty_rows=False,
            raise_if_empty=False,
        )
    except Exception as error:  # the reader raises many kinds of errors for a broken file
        raise RecordError(f"{path}: not a readable workbook: {error}") from None
    tables: dict[str, ArrayTable] = {}
    problems = []
    for name, frame in sheets.items():
        if frame.height == 0:
            continue
        try:
            tables[name] = _read_sheet(path, f"{path}, sheet {name!r}", frame, header)
        except RecordError as error:
            problems.append(error)
    if not tables:
        raise problems[0] if problems else RecordError(f"{path}: all sheets are empty")
    if len(tables) > 1:
        return [table.within(name) for name, table in tables.items()]
    return list(tables.values())


def _read_sheet(
    path: Path, where: str, frame: pl.DataFrame, header: list[str] | None
) -> ArrayTable:
    lines = ["\t".join(cell or "" for cell in row) for row in frame.head(800).iter_rows()]
    structure = find_structure(lines[:600], lines[600:], where, header)
    rows = frame.slice(structure.first_line)
    columns = {}
    for n, name in enumerate(structure.names):
        if name is None:
            continue
        numbers = rows.to_series(n).cast(pl.Float64, strict=False)
        if numbers.null_count() < rows.height:
            columns[name] = numbers.fill_null(float("nan")).to_numpy()
    table = ArrayTable(columns, path)
    table.said = structure.said
    return table
