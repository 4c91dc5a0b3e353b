"""Parquet, Arrow (Feather) and JSON files, read with Polars."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import polars as pl

from ...core.input_files import most_unpacked
from ...errors import RecordError
from .lazy import BROKEN, as_columns, frames
from .table import BATCH, Columns, Table

Source = Path | io.BytesIO


class FrameTable(Table):
    """Columns of a file that Polars scans."""

    def __init__(
        self,
        path: Path,
        scan: Callable[[Source], pl.LazyFrame],
        format_name: str,
        mapped: bool = False,
    ) -> None:
        self.path = path
        self._limit = most_unpacked(path)
        try:
            self._lazy = _unpacked(path, scan(_source(path)))
            self._schema = self._lazy.collect_schema()
            self.rows = int(self._lazy.select(pl.len()).collect().item())
            self._lazy = self._lazy.with_columns(self._stamps_as_seconds())
        except BROKEN as error:
            raise RecordError(f"{path}: not a readable {format_name} file: {error}") from None
        self.columns = list(self._schema.names())
        # Each read maps the file and keeps the pages once read, or unpacks batches again.
        self._mapped = mapped and self._plain_size() <= path.stat().st_size

    def _check_size(self, names: Sequence[str]) -> None:
        """Raise RecordError if whole columns unpack to far more bytes than the file has."""
        if (unpacked := 8 * self.rows * len(set(names))) > self._limit:
            raise RecordError(
                f"{self.path}: columns {', '.join(names)} unpack to {unpacked} bytes, more than "
                f"{self._limit}: the values repeat. If the file is a log, save it as .npy"
            )

    def _plain_size(self) -> int:
        """Return the uncompressed size of the numeric columns [bytes]."""
        numbers = [pl.Series(dtype=kind) for kind in self._schema.values() if kind.is_numeric()]
        return self.rows * sum(int(column.to_numpy().dtype.itemsize) for column in numbers)

    def _stamps_as_seconds(self) -> list[pl.Expr]:
        """Return expressions of time stamps in seconds since the first stamp."""
        stamps = [name for name, kind in self._schema.items() if kind.is_temporal()]
        if not stamps or not self.rows:
            return []
        self._check_size(stamps)
        first = self._lazy.select(stamps).head(1).collect()
        expressions = []
        for name in stamps:
            nanoseconds = _nanoseconds(pl.col(name), self._schema[name])
            expressions.append((nanoseconds - first.select(nanoseconds).item()) / 1e9)
        return expressions

    def batches(
        self, names: Sequence[str], first: int, last: int, size: int = BATCH
    ) -> Iterator[Columns]:
        for name in names:
            kind = self._schema[name]
            if not (kind.is_numeric() or kind.is_temporal() or kind == pl.Boolean):
                raise RecordError(f"{self.path}: column {name!r} holds {kind}, not numbers")
        self._check_size(names)
        try:
            step = size if self._mapped else last - first
            for start in range(first, last, max(1, step)):
                for frame in frames(self._lazy, names, start, min(start + step, last), size):
                    yield as_columns(frame)
        except BROKEN as error:
            raise RecordError(f"{self.path}: reading failed midway: {error}") from None


def _unpacked(path: Path, lazy: pl.LazyFrame) -> pl.LazyFrame:
    """Return the samples of a table whose cells hold whole signals, one record per row.

    Of signals with different lengths, those with the most usual length remain.

    Raises
    ------
    RecordError
        The table has several records.
    """
    lists = [
        name
        for name, kind in lazy.collect_schema().items()
        if isinstance(kind, pl.List | pl.Array) and kind.inner.is_numeric()
    ]
    if not lists:
        return lazy
    head = lazy.select(pl.col(name).cast(pl.List(pl.Float64)) for name in lists)
    lengths = head.select(pl.all().list.len()).head(2).collect()
    if len(lengths) != 1:
        raise RecordError(
            f"{path}: its cells hold whole signals ({', '.join(lists)}), and each row is a record. "
            f"Write one file per record, for example with Polars: "
            f"frame[k].explode(pl.col(pl.List)).write_parquet('record.parquet')"
        )
    rows = lengths.row(0)
    usual = max(rows, key=rows.count)
    kept = [name for name, count in zip(lists, rows, strict=True) if count == usual]
    return lazy.select(pl.col(name).cast(pl.List(pl.Float64)) for name in kept).explode(kept)


def _nanoseconds(column: pl.Expr, kind: pl.DataType) -> pl.Expr:
    if kind == pl.Duration:
        return column.dt.total_nanoseconds()
    if kind == pl.Time:
        return column.cast(pl.Int64)
    return column.cast(pl.Datetime("ns")).dt.timestamp("ns")


def _source(path: Path) -> Source:
    """Return the path, or the content if the name is not UTF-8: Polars cannot open such a name."""
    try:
        str(path).encode("utf-8")
    except UnicodeEncodeError:
        return io.BytesIO(path.read_bytes())
    return path


def open_parquet(path: Path) -> list[Table]:
    """Open the table of a Parquet file."""
    return [FrameTable(path, pl.scan_parquet, "Parquet")]


def open_arrow(path: Path) -> list[Table]:
    """Open the table of an Arrow file (Feather version 2) or an Arrow stream."""
    try:
        return [FrameTable(path, pl.scan_ipc, "Arrow", mapped=True)]
    except RecordError:
        with path.open("rb") as file:
            if file.read(4) != b"\xff\xff\xff\xff":
                raise
    return [FrameTable(path, lambda p: pl.read_ipc_stream(p).lazy(), "Arrow stream")]


def open_json(path: Path) -> list[Table]:
    """Read the whole table of a JSON file, which is an object of columns or a list of rows."""
    return [FrameTable(path, _json, "JSON table")]


def open_json_lines(path: Path) -> list[Table]:
    """Open the table of a file with one JSON object per line."""
    return [FrameTable(path, pl.scan_ndjson, "JSON lines")]


def _json(path: Source) -> pl.LazyFrame:
    frame = pl.read_json(path)
    columns = [name for name, kind in frame.schema.items() if kind == pl.List]
    return frame.select(columns).explode(columns).lazy() if columns else frame.lazy()
