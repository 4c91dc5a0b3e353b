"""A campaign with trivial scenarios, for tests of everything except the simulation.

python -m support.trivial FOLDER SCENARIOS SCHEDULER WORKERS
"""

from __future__ import annotations

import random
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import polars as pl

from fluxobs.campaigns import dataset
from fluxobs.campaigns.campaign import fill
from fluxobs.campaigns.columns import schema
from fluxobs.campaigns.dataset import ROWS, Chunk, Dataset
from fluxobs.campaigns.draws import POINT, generator
from fluxobs.campaigns.specification import Specification
from fluxobs.core.engine import locked, write_part

#: Scenarios per chunk.
SIZE = 50


@dataclass(frozen=True)
class Trivial:
    """Return rows that depend only on their numbers, after a pause."""

    folder: str
    pause: float = 0.02
    rows: int = 0

    def __call__(self, chunk: Chunk) -> float:
        time.sleep(self.pause * random.random())
        numbers = range(chunk.first, self.rows + chunk.first if self.rows else chunk.last)
        values = [float(generator(1, number, POINT).random()) for number in numbers]
        rows = [{"number": n, "rms": value} for n, value in zip(numbers, values, strict=True)]
        frame = pl.DataFrame(rows, schema=schema(specification(1)))
        write_part(frame, Path(self.folder) / ROWS / chunk.file)
        return 0.0


def specification(scenarios: int) -> Specification:
    return Specification(machines=["servo-400w"], scenarios=scenarios, observers=["plain"], seed=1)


def drive(folder: Path, scenarios: int, scheduler: str, workers: int) -> Dataset:
    """Run the missing scenarios, as `campaign` does."""
    with locked(folder):
        campaign = dataset.create(folder, specification(scenarios), SIZE)
        fill(campaign, Trivial(str(folder)), workers, scheduler, lambda done, total: None)
    return campaign


if __name__ == "__main__":
    drive(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3], int(sys.argv[4]))
