"""Excel workbooks: each sheet is read as text, so that preambles and units are found as there."""

from __future__ import annotations

from pathlib import Path

import polars as pl

from ...errors import RecordError
from .arrays import ArrayTable
from .extras import library
from .isolated import read_apart
from .table import Table
from .text.structure import find
from .workbook import check_cells, unpacked_size

#: Memory of the process that reads a workbook: what every one takes, an almost empty sheet of .xls
#: with content in its last cell included, and for each byte of an unpacked part. A cell takes 80
#: bytes, and has 32 as XML.
LEAST, PER_BYTE = 1 << 30, 4
#: Its time, likewise [s]; ten million bytes take a second.
LEAST_TIME, TIME_PER_BYTE = 60.0, 1e-6
#: Bytes of XML for a byte of .xls, of which a cell has six.
XLS = 6


def open_excel(path: Path, header: list[str] | None = None) -> list[Table]:
    """Tables of the sheets that have one; "sheet/column" if there are several."""
    library("fastexcel", "excel", path)
    packed = path.suffix.lower() != ".xls"
    size = unpacked_size(path) if packed else XLS * path.stat().st_size
    memory, seconds = LEAST + PER_BYTE * size, LEAST_TIME + TIME_PER_BYTE * size
    return [*read_apart(read_sheets, path, header, memory, seconds)]


def read_sheets(path: Path, header: list[str] | None) -> list[ArrayTable]:
    """The same, in this process."""
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
    except Exception as error:  # the reader raises many kinds for a broken file
        raise RecordError(f"{path}: not a readable workbook: {error}") from None
    found: dict[str, ArrayTable] = {}
    problems = []
    for name, frame in sheets.items():
        if frame.height == 0:
            continue
        try:
            found[name] = _sheet(path, f"{path}, sheet {name!r}", frame, header)
        except RecordError as error:
            problems.append(error)
    if not found:
        raise problems[0] if problems else RecordError(f"{path}: all sheets are empty")
    if len(found) > 1:
        return [table.within(name) for name, table in found.items()]
    return list(found.values())


def _sheet(path: Path, where: str, frame: pl.DataFrame, header: list[str] | None) -> ArrayTable:
    lines = ["\t".join(cell or "" for cell in row) for row in frame.head(800).iter_rows()]
    found = find(lines[:600], lines[600:], where, header)
    rows = frame.slice(found.first_line)
    columns = {}
    for n, name in enumerate(found.names):
        if name is None:
            continue
        numbers = rows.to_series(n).cast(pl.Float64, strict=False)
        if numbers.null_count() < rows.height:
            columns[name] = numbers.fill_null(float("nan")).to_numpy()
    table = ArrayTable(columns, path)
    table.said = found.said
    return table
