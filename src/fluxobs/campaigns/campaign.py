"""A campaign from its specification to its rows."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..core.engine import LOCAL, compute, locked
from ..core.output import make_folder
from ..core.symlinks import open_own
from ..errors import FluxobsError
from . import dataset
from .chunk import ChunkTask
from .dataset import TIMES, WORST, Chunk, Dataset
from .draws import total
from .specification import Specification, check, read_specification
from .worst import Keep, lacking


def campaign(
    specification: Specification | str | Path,
    out: str | Path,
    *,
    workers: int | None = None,
    scheduler: str = LOCAL,
    progress: Callable[[int, int], Any] = lambda done, total: None,
) -> Dataset:
    """Simulate all scenarios of a specification that are not in the folder yet.

    Parameters
    ----------
    specification : Specification, or the path of a TOML file
    out : path
        Folder of the results. If it holds the same campaign, what is missing is done.
    workers : int, optional
        Processes; default one per processor.
    scheduler : str
        "local" (Dask if it is installed), "pool" (a pool of processes), or the address of a Dask
        scheduler whose workers see `out` by the same name.
    progress : callable
        Called with the number of scenarios done, and of all.

    Returns
    -------
    Dataset

    Raises
    ------
    FluxobsError
        The specification is impossible; the folder holds something else, or is in use; a file
        cannot be written; the workers cannot be had.
    """
    if isinstance(specification, Specification):
        given = specification
        size = _chunk_size(given)
    else:
        given = read_specification(specification)
        try:
            size = _chunk_size(given)
        except FluxobsError as error:
            raise FluxobsError(f"{specification}: {error}") from None
    folder = make_folder(out).resolve()
    with locked(folder):
        found = dataset.create(folder, given, size)
        fill(found, ChunkTask(str(folder), given.canonical()), workers, scheduler, progress)
        make_folder(folder / WORST)
        keep = Keep(str(folder), given.canonical())
        for _ in compute(lacking(found), keep, workers, scheduler):
            pass
    return found


def fill(
    found: Dataset,
    work: Callable[[Chunk], float],
    workers: int | None,
    scheduler: str,
    progress: Callable[[int, int], Any],
) -> None:
    """Do the chunks of a dataset that are not there; `work` writes one and returns its seconds."""
    count = total(found.specification)
    done = count - found.lacking()
    progress(done, count)
    with os.fdopen(open_own(found.folder / TIMES), "a", encoding="utf-8") as times:
        for chunk, seconds in compute(found.missing(), work, workers, scheduler):
            times.write(f"{chunk.first},{chunk.last},{seconds:.3f}\n")
            times.flush()
            done += chunk.last - chunk.first
            progress(done, count)


def _chunk_size(specification: Specification) -> int:
    """Scenarios of a chunk; checks every machine and observer before the first worker starts."""
    from .drives import cell_of
    from .observed import check_observer
    from .simulated import lanes_for

    check(specification)
    sizes = []
    for name in specification.machines:
        cell = cell_of(specification, name)
        for table in specification.observers:
            check_observer(table, cell)
        h = cell.rated.sample_time
        if specification.course.duration < 10 * h:
            raise FluxobsError(f"course.duration is less than ten samples of {name}, {h:g} s each")
        sizes.append(dataset.chunk_size(specification, lanes_for(specification, h), h))
    return min(sizes)
