"""The folder of a campaign: its specification, and a Parquet file for every chunk of scenarios.

A chunk's file is its checkpoint: a run does the chunks whose files are not there.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import polars as pl

from ..core.output import make_folder, write_text
from ..errors import FluxobsError
from ..machines import as_machine
from .columns import schema
from .draws import total
from .specification import Specification, hashed

#: Files of a campaign's folder.
MANIFEST, ROWS, TIMES, WORST = "campaign.json", "rows", "times.csv", "worst"
#: Seconds of work in a chunk, about; and of a drive's or an observer's sample, about.
CHUNK_TIME, SAMPLE_TIME = 10.0, 1.2e-6
#: Largest number of batches in a chunk, for scenarios that cost nothing.
MOST_BATCHES = 64
#: A machine's scenarios are in at least this many chunks, so that workers end together.
LEAST_CHUNKS = 16


class Chunk(NamedTuple):
    """Scenarios `first` to `last`, exclusive, of one machine."""

    first: int
    last: int

    def __str__(self) -> str:
        return f"scenarios {self.first} to {self.last - 1}"

    @property
    def file(self) -> str:
        """Name of its file."""
        return f"{self.first:08d}.parquet"


@dataclass(frozen=True)
class Dataset:
    """A campaign and the folder of its results.

    Attributes
    ----------
    folder : Path
    specification : Specification
    size : int
        Scenarios of a chunk.
    changed : str
        Why its rows cannot be repeated, in words; empty if they can.
    """

    folder: Path
    specification: Specification
    size: int
    changed: str = ""

    def chunks(self) -> Iterator[Chunk]:
        """All chunks, in order."""
        per_machine = self.specification.scenarios
        for start in range(0, total(self.specification), per_machine):
            for first in range(start, start + per_machine, self.size):
                yield Chunk(first, min(first + self.size, start + per_machine))

    def missing(self) -> Iterator[Chunk]:
        """Chunks without a file, in order."""
        there = {path.name for path in (self.folder / ROWS).iterdir()}
        return (chunk for chunk in self.chunks() if chunk.file not in there)

    def lacking(self) -> int:
        """Scenarios that are missing."""
        return sum(chunk.last - chunk.first for chunk in self.missing())

    def scan(self) -> pl.LazyFrame:
        """All rows that are there, lazily.

        Raises
        ------
        FluxobsError
            A file is damaged, or not of this campaign.
        """
        wanted = pl.Schema(schema(self.specification))
        files = [self.folder / ROWS / chunk.file for chunk in self.chunks()]
        files = [file for file in files if file.exists()]
        for file in files:
            try:
                there = pl.read_parquet_schema(file)
            except (OSError, pl.exceptions.PolarsError) as error:
                raise FluxobsError(f"{file}: cannot be read: {error}; {self._mend}") from None
            if there != dict(wanted):
                raise FluxobsError(f"{file}: its columns are not those of rows; {self._mend}")
        return pl.scan_parquet(files, glob=False)  # a folder's name is no pattern

    @contextmanager
    def reading(self) -> Iterator[None]:
        """Says so if a file turns out to be damaged while :meth:`scan` is collected."""
        try:
            yield
        except (OSError, pl.exceptions.PolarsError) as error:
            place = self.folder / ROWS
            raise FluxobsError(f"{place}: a file is damaged: {error}; {self._mend}") from None

    @property
    def _mend(self) -> str:
        return f"delete it, and `fluxobs campaign {self.folder}` makes it again"

    def rows(self) -> pl.DataFrame:
        """All rows, by number and observer.

        Raises
        ------
        FluxobsError
            Chunks are missing or damaged.
        """
        self.check_complete()
        with self.reading():
            return self.scan().collect()

    def check_complete(self) -> None:
        """Raise FluxobsError if chunks are missing."""
        lacking = self.lacking()
        if lacking:
            raise FluxobsError(
                f"{self.folder}: {lacking} of {total(self.specification)} scenarios are missing; "
                f"`fluxobs campaign {self.folder}` does them"
            )


def chunk_size(specification: Specification, lanes: int, sample_time: float) -> int:
    """Scenarios of a chunk: whole batches, about ten seconds of work."""
    rows = specification.course.duration / sample_time
    each = rows * SAMPLE_TIME * (1 + len(specification.observers))
    batches = min(CHUNK_TIME / (each * lanes), MOST_BATCHES)
    batches = min(batches, specification.scenarios / lanes / LEAST_CHUNKS)
    return lanes * max(1, int(batches))


def manifest(specification: Specification, size: int) -> dict[str, Any]:
    """Everything on which the rows depend, as JSON can hold it."""
    return {
        "fluxobs": version("fluxobs"),
        "chunk": size,
        "machines": {name: hashed(repr(as_machine(name))) for name in specification.machines},
        "specification": json.loads(specification.canonical()),
    }


def create(folder: str | Path, specification: Specification, size: int) -> Dataset:
    """The dataset of a campaign in a folder: a new one, or the same one to go on with.

    Raises
    ------
    FluxobsError
        The folder holds another campaign, or something else.
    """
    _check_text(Path(folder))
    folder = make_folder(folder)
    place = folder / MANIFEST
    told = manifest(specification, size)
    if place.exists():
        there = _manifest(place)
        changed = _difference(there, told)
        if changed:
            raise FluxobsError(f"{folder}: holds another campaign ({changed}); give another --out")
        size = there["chunk"]
    elif any(path.name != ".lock" for path in folder.iterdir()):
        raise FluxobsError(f"{folder}: is not empty and holds no campaign; give another --out")
    else:
        write_text(place, json.dumps(told, indent=1, ensure_ascii=False) + "\n")
    make_folder(folder / ROWS)
    return Dataset(folder, specification, size)


def open_dataset(folder: str | Path) -> Dataset:
    """The dataset in a folder.

    Raises
    ------
    FluxobsError
        There is none.
    """
    folder = Path(folder)
    _check_text(folder)
    place = folder / MANIFEST
    if not place.exists():
        raise FluxobsError(f"{folder}: holds no campaign ({MANIFEST} is missing)")
    there = _manifest(place)
    try:
        specification = Specification(**there["specification"])
    except FluxobsError as error:
        raise FluxobsError(
            f"{place}: made with fluxobs {there['fluxobs']}, this is {version('fluxobs')}: {error}"
        ) from None
    try:
        changed = _difference(there, manifest(specification, there["chunk"]))
    except FluxobsError as error:
        changed = str(error)
    return Dataset(folder, specification, there["chunk"], changed)


def _check_text(folder: Path) -> None:
    """Raise FluxobsError if Polars cannot read in the folder: it takes names that are text."""
    try:
        str(folder.resolve()).encode()
    except UnicodeEncodeError:
        raise FluxobsError(f"{folder}: this name is not UTF-8; give another folder") from None


def _manifest(place: Path) -> dict[str, Any]:
    try:
        found = json.loads(place.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FluxobsError(f"{place}: cannot be read: {error}") from None
    kinds = {"fluxobs": str, "chunk": int, "machines": dict, "specification": dict}
    whole = isinstance(found, dict) and all(isinstance(found.get(k), t) for k, t in kinds.items())
    if not whole or found["chunk"] < 1:
        raise FluxobsError(
            f"{place}: is damaged, or older than fluxobs {version('fluxobs')}; begin again in "
            f"another folder"
        )
    return dict(found)


def _difference(there: dict[str, Any], now: dict[str, Any]) -> str:
    """What differs between two manifests, in words; empty if nothing does."""
    if there["fluxobs"] != now["fluxobs"]:
        return f"made with fluxobs {there['fluxobs']}, this is {now['fluxobs']}"
    old, new = there["specification"], now["specification"]
    names = [name for name in new if old.get(name) != new[name]]
    if names:
        return f"its {', '.join(names)} differ"
    machines = [name for name, one in now["machines"].items() if there["machines"].get(name) != one]
    return f"{', '.join(machines)} changed" if machines else ""
