"""Batches of a Polars lazy frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import polars as pl

from .table import Columns

#: Exceptions of Polars for a broken file. PanicException is not a subclass of Exception.
BROKEN = (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError)


def frames(
    lazy: pl.LazyFrame, names: Sequence[str], first: int, last: int, size: int
) -> Iterator[pl.DataFrame]:
    """Yield rows first … last - 1 in order, about `size` rows per frame."""
    selected = lazy.select(list(dict.fromkeys(names))).slice(first, last - first)
    if last - first <= size:
        yield selected.collect()
    else:
        yield from selected.collect_batches(chunk_size=size, maintain_order=True)


def as_columns(frame: pl.DataFrame) -> Columns:
    """Convert a frame to float columns, and null to NaN."""
    return {
        name: frame[name].cast(pl.Float64).fill_null(np.nan).to_numpy() for name in frame.columns
    }
