"""Many tasks on many workers, as they come: constant memory, retries, back pressure."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

from ...errors import FluxobsError, UsageError
from .environment import for_workers

Task = TypeVar("Task")

#: Words for the scheduler: Dask's on this machine if it is installed, else the pool; the pool.
LOCAL, POOL = "local", "pool"
#: Tasks handed out per worker: one that it works on, one that waits.
AHEAD = 2
#: How often a task is tried whose worker dies.
TRIES = 5
#: What to return for a task that is given up.
Lost = Callable[[Any], Any]


def processors() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def compute(
    tasks: Iterable[Task],
    work: Callable[[Task], Any],
    workers: int | None = None,
    scheduler: str = LOCAL,
    lost: Lost | None = None,
) -> Iterator[tuple[Task, Any]]:
    """Do tasks in other processes; yields each with its result, in the order in which they end.

    Parameters
    ----------
    tasks : iterable
        Taken as workers become free; small things that can be pickled.
    work : callable
        A function of a module, or a partial of one; must give the same when it is done twice.
    workers : int, optional
        Processes on this machine; default one per processor.
    scheduler : str
        "local", "pool", or the address of a Dask scheduler (``tcp://host:8786``).
    lost : callable, optional
        Result of a task whose worker died five times; default, the run ends there.

    Raises
    ------
    FluxobsError
        `work` raised it; a task's worker died five times; or the scheduler cannot be reached.
    """
    if scheduler not in (LOCAL, POOL) and "://" not in scheduler:
        raise UsageError(
            f"scheduler {scheduler!r}: local, pool, or an address such as tcp://host:8786"
        )
    if workers is not None and workers < 1:
        raise UsageError(f"workers must be at least 1, got {workers}")
    with for_workers():
        if scheduler == POOL or (scheduler == LOCAL and not _dask()):
            from .pool import in_pool

            yield from in_pool(tasks, work, workers or processors(), lost or give_up)
        else:
            from .cluster import in_cluster

            address = None if scheduler == LOCAL else scheduler
            yield from in_cluster(tasks, work, workers or processors(), address, lost or give_up)


def give_up(task: Any) -> Any:
    """End the run at a task that always kills its worker."""
    raise FluxobsError(
        f"{task}: its worker died {TRIES} times, as one does that has no memory left; take fewer "
        f"workers"
    )


def _dask() -> bool:
    from importlib.util import find_spec

    return find_spec("distributed") is not None
