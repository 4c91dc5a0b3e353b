"""The worst scenarios of a campaign, kept with their records."""

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
from .specification import ADAPTIVE, PLAIN, Specification

#: How many of each observer are kept.
KEPT = 10


class Worst(NamedTuple):
    """Scenarios of one machine to keep with one observer."""

    observer: str
    numbers: tuple[int, ...]

    def __str__(self) -> str:
        return f"scenarios {', '.join(map(str, self.numbers))} with {self.observer}"


def stem(specification: Specification, number: int, observer: str) -> str:
    """Name of the files of a scenario with an observer, without their endings."""
    place = specification.observers.index(specification.observer(observer))
    words = re.sub(r"[^a-z0-9]+", "-", observer.lower()).strip("-")
    return f"{number:08d}-{place}-{words}"  # other names may have the same words


def worst(rows: pl.LazyFrame, observer: str) -> pl.DataFrame:
    """The rows with the largest errors that an observer called valid, the largest first."""
    mine = rows.filter((pl.col("observer") == observer) & pl.col("worst").is_not_null())
    return mine.sort("worst", "number", descending=[True, False]).head(KEPT).collect()


def lacking(found: Dataset) -> Iterator[Worst]:
    """What is to be kept and is not there yet, by machine."""
    rows = found.scan()
    for table in found.specification.observers:
        with found.reading():
            kept = worst(rows, table.name)
        for machine in found.specification.machines:
            numbers = kept.filter(pl.col("machine") == machine)["number"].to_list()
            lack = [n for n in numbers if not _record(found, n, table.name).exists()]
            if lack:
                yield Worst(table.name, tuple(lack))


def _record(found: Dataset, number: int, observer: str) -> Path:
    return found.folder / WORST / f"{stem(found.specification, number, observer)}.parquet"


@dataclass(frozen=True)
class Keep:
    """The work of keeping some; as a function it is sent to the workers."""

    folder: str
    specification: str

    def __call__(self, what: Worst) -> None:
        """Simulate them again; write their records, and reports of those that fluxobs estimates."""
        from .rerun import rerun, write_record

        specification = specification_of(self.specification)
        for one in rerun(specification, what.numbers, what.observer):
            name = stem(specification, one.number, what.observer)
            place = Path(self.folder) / WORST / name
            if one.table.kind in (PLAIN, ADAPTIVE) and can_report():
                one.estimate().write(place.with_suffix(".html"))
            write_record(one, place.with_suffix(".parquet"))


def can_report() -> bool:
    """Whether interactive reports can be made: their template is built with the page."""
    try:
        built("report.html")
    except ValueError:
        return False
    return True
