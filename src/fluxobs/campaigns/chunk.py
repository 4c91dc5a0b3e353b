"""The task of a worker: one chunk of a campaign."""

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
    """A task that computes and writes the rows of a chunk; it is sent to the workers.

    Attributes
    ----------
    folder : str
        Folder of the dataset; all workers see it under this path.
    specification : str
        The specification as JSON.
    """

    folder: str
    specification: str

    def __call__(self, chunk: Chunk) -> float:
        """Write the rows of a chunk; return the time taken [s]."""
        started = time.perf_counter()
        from .rows import rows_of

        rows = rows_of(specification_of(self.specification), chunk.first, chunk.last)
        write_part(rows, Path(self.folder) / ROWS / chunk.file)
        return time.perf_counter() - started


@lru_cache(maxsize=2)
def specification_of(text: str) -> Specification:
    """Return the specification in a JSON text, parsed once per process."""
    return Specification(**Specification.model_validate_json(text).model_dump())
