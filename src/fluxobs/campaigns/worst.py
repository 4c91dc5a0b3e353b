"""The records of a campaign's worst scenarios."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import polars as pl

from ..page import built
from .chunk import specification_of
from .dataset import WORST, Dataset
from .specification import REPORTED, Specification

#: Number of worst scenarios whose records are written, per observer.
KEPT = 10


class Worst(NamedTuple):
    """Scenarios of one machine whose records with one observer are to be written."""

    observer: str
    numbers: tuple[int, ...]

    def __str__(self) -> str:
        return f"scenarios {', '.join(map(str, self.numbers))} with {self.observer}"


def stem(specification: Specification, number: int, observer: str) -> str:
    """Return the file name of a scenario with an observer, without suffix."""
    position = specification.observers.index(specification.observer(observer))
    slug = re.sub(r"[^a-z0-9]+", "-", observer.lower()).strip("-")
    return f"{number:08d}-{position}-{slug}"  # the position distinguishes equal slugs


def worst(rows: pl.LazyFrame, observer: str) -> pl.DataFrame:
    """Return the scenarios of an observer with the largest errors on valid rows, largest first."""
    valid = rows.filter((pl.col("observer") == observer) & pl.col("worst").is_not_null())
    return valid.sort("worst", "number", descending=[True, False]).head(KEPT).collect()


def missing_records(dataset: Dataset) -> Iterator[Worst]:
    """Yield the worst scenarios without a record, by observer and machine."""
    rows = dataset.scan()
    for table in dataset.specification.observers:
        with dataset.reading():
            worst_rows = worst(rows, table.name)
        for machine in dataset.specification.machines:
            numbers = worst_rows.filter(pl.col("machine") == machine)["number"].to_list()
            missing = [n for n in numbers if not _record_path(dataset, n, table.name).exists()]
            if missing:
                yield Worst(table.name, tuple(missing))


def _record_path(dataset: Dataset, number: int, observer: str) -> Path:
    return dataset.folder / WORST / f"{stem(dataset.specification, number, observer)}.parquet"


@dataclass(frozen=True)
class RecordTask:
    """A task that writes the records of worst scenarios; it is sent to the workers."""

    folder: str
    specification: str

    def __call__(self, worst: Worst) -> None:
        """Repeat the scenarios; write their records, and for plain and adaptive also reports."""
        from .rerun import rerun, write_record

        specification = specification_of(self.specification)
        for repeated in rerun(specification, worst.numbers, worst.observer):
            name = stem(specification, repeated.number, worst.observer)
            path = Path(self.folder) / WORST / name
            if repeated.table.kind in REPORTED and can_report():
                repeated.estimate().write(path.with_suffix(".html"))
            write_record(repeated, path.with_suffix(".parquet"))


def can_report() -> bool:
    """Return whether the page's template is built, which interactive reports need."""
    try:
        built("report.html")
    except ValueError:
        return False
    return True
