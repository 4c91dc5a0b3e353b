"""A pool of processes on this machine that survives the death of its workers."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

from .policy import MAX_ATTEMPTS, TASKS_PER_WORKER, GivenUp

Task = TypeVar("Task")

#: Longest wait of the driver [s]; after it, the driver notices a Ctrl-C of another thread.
WAKE_UP = 0.5


def _prepare_worker() -> None:
    """Ignore Ctrl-C, which the driver handles, and end when the driver dies."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def in_pool(
    tasks: Iterable[Task], work: Callable[[Task], Any], workers: int, lost: GivenUp
) -> Iterator[tuple[Task, Any]]:
    """See :func:`compute`.

    When a worker dies, the pool does not say which task the worker had. All tasks under way are
    repeated, one at a time; a task that always kills its worker then affects no other task.
    """
    upcoming = iter(tasks)
    retries: list[tuple[Task, int]] = []  # task, number of attempts so far
    exhausted = False
    while not exhausted or retries:
        pool = ProcessPoolExecutor(
            workers, mp_context=multiprocessing.get_context("spawn"), initializer=_prepare_worker
        )
        under_way: dict[Future[Any], tuple[Task, int]] = {}
        try:
            while True:
                limit = 1 if retries else TASKS_PER_WORKER * workers
                while len(under_way) < limit and (retries or not exhausted):
                    if retries:
                        task, attempts = retries.pop()
                    else:
                        try:
                            task, attempts = next(upcoming), 0
                        except StopIteration:
                            exhausted = True
                            break
                    try:
                        under_way[pool.submit(work, task)] = (task, attempts)
                    except BrokenProcessPool:
                        retries.append((task, attempts))
                        raise
                    if attempts:
                        break
                if not under_way:
                    break
                for future in wait(under_way, WAKE_UP, FIRST_COMPLETED).done:
                    result = future.result()  # may raise; the task then stays in under_way
                    task, _ = under_way.pop(future)
                    yield task, result
        except BrokenProcessPool:
            retries += [(task, attempts + 1) for task, attempts in under_way.values()]
        except BaseException:
            _kill_workers(pool)
            raise
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
        given_up = [task for task, attempts in retries if attempts >= MAX_ATTEMPTS]
        retries = [(task, attempts) for task, attempts in retries if attempts < MAX_ATTEMPTS]
        for task in given_up:
            yield task, lost(task)


def _kill_workers(pool: ProcessPoolExecutor) -> None:
    """Kill the workers at once, since a stopped run does not wait for their tasks."""
    if hasattr(pool, "kill_workers"):  # Python 3.14 and later
        pool.kill_workers()
        return
    for process in list((pool._processes or {}).values()):
        process.kill()
