"""Run a campaign: simulate its scenarios and store its rows."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..core.engine import LOCAL, compute, locked
from ..core.output import make_folder
from ..core.symlinks import open_own
from ..errors import FluxobsError
from .chunk import ChunkTask
from .dataset import TIMES, WORST, Chunk, Dataset, chunk_size, create
from .draws import total
from .specification import Specification, check, read_specification
from .worst import RecordTask, missing_records


def campaign(
    specification: Specification | str | Path,
    out: str | Path,
    *,
    workers: int | None = None,
    scheduler: str = LOCAL,
    progress: Callable[[int, int], Any] = lambda done, total: None,
) -> Dataset:
    """Simulate the scenarios of a specification that are not in the folder yet.

    Parameters
    ----------
    specification : Specification, or the path of a TOML file
    out : path
        Folder of the results. If the folder holds this campaign, only missing scenarios are
        simulated.
    workers : int, optional
        Number of processes; default one per processor.
    scheduler : str
        "local" (Dask if it is installed), "pool" (a pool of processes), or the address of a Dask
        scheduler whose workers see `out` under the same path.
    progress : callable
        Called with the numbers of finished scenarios and of all scenarios.

    Returns
    -------
    Dataset

    Raises
    ------
    FluxobsError
        The specification is impossible; the folder holds other files or is in use; a file cannot be
        written; the workers cannot be started.
    """
    if isinstance(specification, Specification):
        checked = specification
        size = _chunk_size(checked)
    else:
        checked = read_specification(specification)
        try:
            size = _chunk_size(checked)
        except FluxobsError as error:
            raise FluxobsError(f"{specification}: {error}") from None
    folder = make_folder(out).resolve()
    with locked(folder):
        dataset = create(folder, checked, size)
        fill(dataset, ChunkTask(str(folder), checked.canonical()), workers, scheduler, progress)
        make_folder(folder / WORST)
        record_task = RecordTask(str(folder), checked.canonical())
        for _ in compute(missing_records(dataset), record_task, workers, scheduler):
            pass
    return dataset


def fill(
    dataset: Dataset,
    task: Callable[[Chunk], float],
    workers: int | None,
    scheduler: str,
    progress: Callable[[int, int], Any],
) -> None:
    """Compute the missing chunks of a dataset; `task` writes a chunk, returns the time [s]."""
    count = total(dataset.specification)
    finished = count - dataset.lacking()
    progress(finished, count)
    with os.fdopen(open_own(dataset.folder / TIMES), "a", encoding="utf-8") as times:
        for chunk, seconds in compute(dataset.missing(), task, workers, scheduler):
            times.write(f"{chunk.first},{chunk.last},{seconds:.3f}\n")
            times.flush()
            finished += chunk.last - chunk.first
            progress(finished, count)


def _chunk_size(specification: Specification) -> int:
    """Check all machines and observers before workers start; return the scenarios per chunk."""
    from .drives import cell_of
    from .observed import check_observer
    from .simulated import lanes_for

    check(specification)
    sizes = []
    for name in specification.machines:
        cell = cell_of(specification, name)
        for observer in specification.observers:
            check_observer(observer, cell)
        sample_time = cell.rated.sample_time
        if specification.course.duration < 10 * sample_time:
            raise FluxobsError(
                f"course.duration is less than ten samples of {name}, {sample_time:g} s each"
            )
        sizes.append(chunk_size(specification, lanes_for(specification, sample_time), sample_time))
    return min(sizes)
