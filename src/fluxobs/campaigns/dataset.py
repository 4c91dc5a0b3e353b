"""The folder of a campaign: its specification, and a Parquet file for each chunk of scenarios.

A chunk's file is its checkpoint: a run computes the chunks whose files are missing.
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
#: Approximate computing time of a chunk, and of one sample of a drive or an observer [s].
CHUNK_TIME, SAMPLE_TIME = 10.0, 1.2e-6
#: Largest number of batches in a chunk, reached with short scenarios.
MAX_BATCHES = 64
#: Smallest number of chunks per machine: many chunks let all workers finish at about the same time.
MIN_CHUNKS = 16


class Chunk(NamedTuple):
    """Scenarios `first` to `last`, exclusive, of one machine."""

    first: int
    last: int

    def __str__(self) -> str:
        return f"scenarios {self.first} to {self.last - 1}"

    @property
    def file(self) -> str:
        """Name of the chunk's file."""
        return f"{self.first:08d}.parquet"


@dataclass(frozen=True)
class Dataset:
    """A campaign and the folder of its results.

    Attributes
    ----------
    folder : Path
    specification : Specification
    size : int
        Scenarios per chunk.
    changed : str
        Reason why the rows cannot be reproduced; empty if they can be reproduced.
    """

    folder: Path
    specification: Specification
    size: int
    changed: str = ""

    def chunks(self) -> Iterator[Chunk]:
        """Yield all chunks, in order."""
        per_machine = self.specification.scenarios
        for start in range(0, total(self.specification), per_machine):
            for first in range(start, start + per_machine, self.size):
                yield Chunk(first, min(first + self.size, start + per_machine))

    def missing(self) -> Iterator[Chunk]:
        """Return the chunks without a file, in order."""
        existing = {path.name for path in (self.folder / ROWS).iterdir()}
        return (chunk for chunk in self.chunks() if chunk.file not in existing)

    def lacking(self) -> int:
        """Return the number of missing scenarios."""
        return sum(chunk.last - chunk.first for chunk in self.missing())

    def scan(self) -> pl.LazyFrame:
        """Return the rows of all existing files as a lazy frame.

        Raises
        ------
        FluxobsError
            A file is damaged or belongs to another campaign.
        """
        expected = pl.Schema(schema(self.specification))
        files = [self.folder / ROWS / chunk.file for chunk in self.chunks()]
        files = [file for file in files if file.exists()]
        for file in files:
            try:
                columns = pl.read_parquet_schema(file)
            except (OSError, pl.exceptions.PolarsError) as error:
                raise FluxobsError(
                    f"{file}: cannot be read: {error}; {self._repair_hint}"
                ) from None
            if columns != dict(expected):
                raise FluxobsError(
                    f"{file}: its columns differ from the campaign's; {self._repair_hint}"
                )
        return pl.scan_parquet(files, glob=False)  # a * in the folder's name is literal

    @contextmanager
    def reading(self) -> Iterator[None]:
        """Raise FluxobsError if collecting :meth:`scan` finds a damaged file."""
        try:
            yield
        except (OSError, pl.exceptions.PolarsError) as error:
            folder = self.folder / ROWS
            raise FluxobsError(
                f"{folder}: a file is damaged: {error}; {self._repair_hint}"
            ) from None

    @property
    def _repair_hint(self) -> str:
        return f"delete it; `fluxobs campaign {self.folder}` recreates it"

    def rows(self) -> pl.DataFrame:
        """Return all rows, sorted by number and observer.

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
        missing = self.lacking()
        if missing:
            raise FluxobsError(
                f"{self.folder}: {missing} of {total(self.specification)} scenarios are missing; "
                f"`fluxobs campaign {self.folder}` simulates them"
            )


def chunk_size(specification: Specification, lanes: int, sample_time: float) -> int:
    """Return the scenarios per chunk: whole batches, about ten seconds of computing."""
    samples = specification.course.duration / sample_time
    scenario_time = samples * SAMPLE_TIME * (1 + len(specification.observers))
    batches = min(CHUNK_TIME / (scenario_time * lanes), MAX_BATCHES)
    batches = min(batches, specification.scenarios / lanes / MIN_CHUNKS)
    return lanes * max(1, int(batches))


def manifest(specification: Specification, size: int) -> dict[str, Any]:
    """Return everything on which the rows depend, for JSON."""
    return {
        "fluxobs": version("fluxobs"),
        "chunk": size,
        "machines": {name: hashed(repr(as_machine(name))) for name in specification.machines},
        "specification": json.loads(specification.canonical()),
    }


def create(folder: str | Path, specification: Specification, size: int) -> Dataset:
    """Create the dataset of a campaign in a folder, or open the campaign's existing dataset.

    Raises
    ------
    FluxobsError
        The folder holds another campaign, or other files.
    """
    _check_text(Path(folder))
    folder = make_folder(folder)
    path = folder / MANIFEST
    current = manifest(specification, size)
    if path.exists():
        stored = _read_manifest(path)
        changed = _describe_difference(stored, current)
        if changed:
            raise FluxobsError(
                f"{folder}: holds another campaign ({changed}); choose another --out"
            )
        size = stored["chunk"]
    elif any(entry.name != ".lock" for entry in folder.iterdir()):
        raise FluxobsError(f"{folder}: is not empty and holds no campaign; choose another --out")
    else:
        write_text(path, json.dumps(current, indent=1, ensure_ascii=False) + "\n")
    make_folder(folder / ROWS)
    return Dataset(folder, specification, size)


def open_dataset(folder: str | Path) -> Dataset:
    """Open the dataset in a folder.

    Raises
    ------
    FluxobsError
        The folder holds no campaign, or a damaged one.
    """
    folder = Path(folder)
    _check_text(folder)
    path = folder / MANIFEST
    if not path.exists():
        raise FluxobsError(f"{folder}: holds no campaign ({MANIFEST} is missing)")
    stored = _read_manifest(path)
    try:
        specification = Specification(**stored["specification"])
    except FluxobsError as error:
        raise FluxobsError(
            f"{path}: made with fluxobs {stored['fluxobs']}, but this is version "
            f"{version('fluxobs')}: {error}"
        ) from None
    try:
        changed = _describe_difference(stored, manifest(specification, stored["chunk"]))
    except FluxobsError as error:
        changed = str(error)
    return Dataset(folder, specification, stored["chunk"], changed)


def _check_text(folder: Path) -> None:
    """Raise FluxobsError if the folder's name is not UTF-8, which Polars needs."""
    try:
        str(folder.resolve()).encode()
    except UnicodeEncodeError:
        raise FluxobsError(f"{folder}: the name is not UTF-8; choose another folder") from None


def _read_manifest(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FluxobsError(f"{path}: cannot be read: {error}") from None
    kinds = {"fluxobs": str, "chunk": int, "machines": dict, "specification": dict}
    complete = isinstance(content, dict) and all(
        isinstance(content.get(k), t) for k, t in kinds.items()
    )
    if not complete or content["chunk"] < 1:
        raise FluxobsError(
            f"{path}: is damaged, or from a fluxobs older than {version('fluxobs')}; start again "
            f"in another folder"
        )
    return dict(content)


def _describe_difference(stored: dict[str, Any], current: dict[str, Any]) -> str:
    """Describe the difference between two manifests; empty if they are equal."""
    if stored["fluxobs"] != current["fluxobs"]:
        return f"made with fluxobs {stored['fluxobs']}, but this is version {current['fluxobs']}"
    before, after = stored["specification"], current["specification"]
    names = [name for name in after if before.get(name) != after[name]]
    if names:
        return f"its {', '.join(names)} differ"
    machines = [
        name
        for name, digest in current["machines"].items()
        if stored["machines"].get(name) != digest
    ]
    return f"{', '.join(machines)} changed" if machines else ""
