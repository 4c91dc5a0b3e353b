"""Many tasks on many workers, with constant memory, retries and back pressure."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

from ...errors import FluxobsError, UsageError
from .environment import for_workers
from .policy import MAX_ATTEMPTS, GivenUp

Task = TypeVar("Task")

#: Names of schedulers. LOCAL is Dask on this machine, or the pool if Dask is not installed.
LOCAL, POOL = "local", "pool"


def processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def compute(
    tasks: Iterable[Task],
    work: Callable[[Task], Any],
    workers: int | None = None,
    scheduler: str = LOCAL,
    lost: GivenUp | None = None,
) -> Iterator[tuple[Task, Any]]:
    """Do tasks in other processes; yield each task with its result, in the order of completion.

    Parameters
    ----------
    tasks : iterable
        Small objects that can be pickled; the next task is read when a worker becomes free.
    work : callable
        A module-level function, or a partial of such a function. A task may be done twice and must
        then give the same result.
    workers : int, optional
        Processes on this machine; by default, one per processor.
    scheduler : str
        "local", "pool", or the address of a Dask scheduler (``tcp://host:8786``).
    lost : callable, optional
        Function that returns the result of a task whose worker died five times. By default the run
        ends.

    Raises
    ------
    FluxobsError
        `work` raised it, a task's worker died five times, or the scheduler cannot be reached.
    """
    if scheduler not in (LOCAL, POOL) and "://" not in scheduler:
        raise UsageError(
            f"scheduler must be local, pool, or an address such as tcp://host:8786; got "
            f"{scheduler!r}"
        )
    if workers is not None and workers < 1:
        raise UsageError(f"workers must be at least 1, got {workers}")
    with for_workers():
        if scheduler == POOL or (scheduler == LOCAL and not _dask_installed()):
            from .pool import in_pool

            yield from in_pool(tasks, work, workers or processors(), lost or give_up)
        else:
            from .cluster import in_cluster

            address = None if scheduler == LOCAL else scheduler
            yield from in_cluster(tasks, work, workers or processors(), address, lost or give_up)


def give_up(task: Any) -> Any:
    """Raise FluxobsError for a task that always kills its worker."""
    raise FluxobsError(
        f"{task}: its worker died {MAX_ATTEMPTS} times, probably out of memory; use fewer workers"
    )


def _dask_installed() -> bool:
    from importlib.util import find_spec

    return find_spec("distributed") is not None
