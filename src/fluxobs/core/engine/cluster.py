"""Dask: a new cluster of processes on this machine, or an existing cluster."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, suppress
from typing import Any, TypeVar

from ...errors import FluxobsError
from .policy import MAX_ATTEMPTS, TASKS_PER_WORKER, GivenUp

Task = TypeVar("Task")

#: Longest wait for a scheduler and for the first worker [s].
PATIENCE = 30
#: Time that tasks wait when no worker is left [s]. Dask may fail to replace a dead worker.
ABANDONED = 60
#: Time for which a count of workers is used again [s].
FRESH = 2.0
_LOST_SCHEDULER = "lost the scheduler; run the same command again to resume"


def in_cluster(
    tasks: Iterable[Task],
    work: Callable[[Task], Any],
    workers: int,
    address: str | None,
    lost: GivenUp,
) -> Iterator[tuple[Task, Any]]:
    """See :func:`compute`; without an address, start a cluster of one thread per process.

    When a worker dies, Dask counts this against all tasks of the worker, also waiting tasks. If
    Dask gives up a task, the task is therefore tried once more alone, so that no other task can
    cause the next death.
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
        "distributed.scheduler.allowed-failures": MAX_ATTEMPTS - 1,
        "distributed.scheduler.no-workers-timeout": f"{ABANDONED}s",
        "distributed.comm.timeouts.connect": PATIENCE,
        "distributed.worker.daemon": True,
    }
    logging.getLogger("distributed").setLevel(logging.ERROR)
    with ExitStack() as stack:
        stack.enter_context(dask.config.set(settings))
        starts_cluster = address is None
        if starts_cluster:
            cluster = LocalCluster(
                n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=":0"
            )
            address = stack.enter_context(cluster).scheduler_address
        try:
            client = stack.enter_context(Client(address, timeout=PATIENCE, set_as_default=False))
            client.wait_for_workers(1, timeout=PATIENCE)
        except (OSError, TimeoutError) as error:
            raise FluxobsError(f"{address}: no scheduler with workers found: {error}") from None
        if starts_cluster:
            stack.callback(_wait_for_workers, client, workers)
        upcoming = iter(tasks)
        under_way: dict[str, Task] = {}
        suspects: list[Task] = []
        alone: set[str] = set()  # keys of suspected tasks that are retried
        completed = as_completed(loop=client.loop, with_results=True, raise_errors=False)
        counted_at, count = 0.0, workers

        def count_workers() -> int:
            """Return the number of workers; to save messages, count only every :data:`FRESH`."""
            nonlocal counted_at, count
            if time.monotonic() - counted_at > FRESH:
                counted_at, count = time.monotonic(), max(1, len(client.ncores()))
            return count

        def submit(task: Task) -> str:
            future = client.submit(work, task, pure=False)
            under_way[future.key] = task
            completed.add(future)
            return str(future.key)

        def hand_out() -> None:
            for _ in range(TASKS_PER_WORKER * count_workers() - len(under_way)):
                task = next(upcoming, None)
                if task is None:
                    break
                submit(task)
            if not under_way and suspects:
                alone.add(submit(suspects.pop()))

        try:
            hand_out()
            for future, result in completed:
                task = under_way.pop(future.key)
                if future.status == "error":
                    problem = result[1] if isinstance(result, tuple) else future.exception()
                    if isinstance(problem, NoWorkerError):
                        raise FluxobsError(
                            f"{address}: no worker is left; run the same command again to resume"
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
                    raise FluxobsError(f"{address}: {_LOST_SCHEDULER}")
                yield task, result
                hand_out()
        except (CommClosedError, OSError):
            raise FluxobsError(f"{address}: {_LOST_SCHEDULER}") from None


def _wait_for_workers(client: Any, workers: int) -> None:
    """Wait until dead workers are replaced, since Dask cannot stop a worker that is starting."""
    with suppress(TimeoutError, OSError):
        client.wait_for_workers(workers, timeout=PATIENCE)
