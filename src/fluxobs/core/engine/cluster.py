"""Dask: a cluster of processes on this machine, or one that is there already."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, suppress
from typing import Any, TypeVar

from ...errors import FluxobsError
from .compute import AHEAD, TRIES, Lost

Task = TypeVar("Task")

#: Seconds to wait for a scheduler, and for its first worker.
PATIENCE = 30
#: Seconds for which tasks wait when no worker is left: Dask may fail to replace one that died.
ABANDONED = 60
#: Seconds for which the number of workers is taken as known.
FRESH = 2.0


def in_cluster(
    tasks: Iterable[Task],
    work: Callable[[Task], Any],
    workers: int,
    address: str | None,
    lost: Lost,
) -> Iterator[tuple[Task, Any]]:
    """See :func:`compute`; without an address a cluster of one thread per process is started.

    Dask counts a death against every task that the worker had, those that waited too. A task that
    is given up so is tried again when no other is under way: then the death is its own.
    """
    try:
        import dask
        from distributed import Client, LocalCluster, as_completed
        from distributed.comm.core import CommClosedError
        from distributed.scheduler import KilledWorker, NoWorkerError
    except ImportError:
        raise FluxobsError(
            'a scheduler needs the extra "cluster": pip install "fluxobs[cluster]"'
        ) from None
    settings = {
        "distributed.scheduler.allowed-failures": TRIES - 1,
        "distributed.scheduler.no-workers-timeout": f"{ABANDONED}s",
        "distributed.comm.timeouts.connect": PATIENCE,
        "distributed.worker.daemon": True,
    }
    logging.getLogger("distributed").setLevel(logging.ERROR)
    with ExitStack() as stack:
        stack.enter_context(dask.config.set(settings))
        own = address is None
        if own:
            cluster = LocalCluster(
                n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=":0"
            )
            address = stack.enter_context(cluster).scheduler_address
        try:
            client = stack.enter_context(Client(address, timeout=PATIENCE, set_as_default=False))
            client.wait_for_workers(1, timeout=PATIENCE)
        except (OSError, TimeoutError) as error:
            raise FluxobsError(f"{address}: no scheduler with workers there: {error}") from None
        if own:
            stack.callback(_all_back, client, workers)
        coming = iter(tasks)
        under_way: dict[str, Task] = {}
        suspects: list[Task] = []
        alone: set[str] = set()  # keys of suspects that are tried again
        done = as_completed(loop=client.loop, with_results=True, raise_errors=False)
        asked, known = 0.0, workers

        def there() -> int:
            """Workers now; clusters grow and shrink, but asking takes a message."""
            nonlocal asked, known
            if time.monotonic() - asked > FRESH:
                asked, known = time.monotonic(), max(1, len(client.ncores()))
            return known

        def submit(task: Task) -> str:
            future = client.submit(work, task, pure=False)
            under_way[future.key] = task
            done.add(future)
            return str(future.key)

        def hand_out() -> None:
            for _ in range(AHEAD * there() - len(under_way)):
                task = next(coming, None)
                if task is None:
                    break
                submit(task)
            if not under_way and suspects:
                alone.add(submit(suspects.pop()))

        try:
            hand_out()
            for future, result in done:
                task = under_way.pop(future.key)
                if future.status == "error":
                    problem = result[1] if isinstance(result, tuple) else future.exception()
                    if isinstance(problem, NoWorkerError):
                        raise FluxobsError(
                            f"{address}: no worker is left; the same command resumes"
                        )
                    if not isinstance(problem, KilledWorker):
                        raise problem
                    if future.key in alone:
                        yield task, lost(task)
                    else:
                        suspects.append(task)
                    hand_out()
                    continue
                if future.status != "finished":
                    raise FluxobsError(
                        f"{address}: the scheduler was lost; the same command resumes"
                    )
                yield task, result
                hand_out()
        except (CommClosedError, OSError):
            raise FluxobsError(
                f"{address}: the scheduler was lost; the same command resumes"
            ) from None


def _all_back(client: Any, workers: int) -> None:
    """Wait until workers that died are replaced: Dask cannot end one that is just being started."""
    with suppress(TimeoutError, OSError):
        client.wait_for_workers(workers, timeout=PATIENCE)
