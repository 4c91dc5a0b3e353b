"""One chunk of a campaign: what a worker does."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from ..core.engine import write_part
from .dataset import ROWS, Chunk
from .specification import Specification


@dataclass(frozen=True)
class ChunkTask:
    """The work on a chunk; as a function it is sent to the workers.

    Attributes
    ----------
    folder : str
        Of the dataset; all workers see it by this name.
    specification : str
        As JSON.
    """

    folder: str
    specification: str

    def __call__(self, chunk: Chunk) -> float:
        """Make the rows of a chunk and write them; returns the seconds that it took."""
        started = time.perf_counter()
        from .rows import rows_of

        rows = rows_of(specification_of(self.specification), chunk.first, chunk.last)
        write_part(rows, Path(self.folder) / ROWS / chunk.file)
        return time.perf_counter() - started


@lru_cache(maxsize=2)
def specification_of(text: str) -> Specification:
    """The specification in a JSON text; read once."""
    return Specification(**Specification.model_validate_json(text).model_dump())
