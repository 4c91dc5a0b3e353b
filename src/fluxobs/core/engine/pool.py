"""A pool of processes on this machine, which survives the death of its workers."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

from .compute import AHEAD, TRIES, Lost

Task = TypeVar("Task")

#: Seconds after which the driver looks up from waiting. Another thread may have got its Ctrl-C.
AWAKE = 0.5


def _started() -> None:
    """A worker leaves Ctrl-C to the driver, and ends with it: a killed driver tells nobody."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def in_pool(
    tasks: Iterable[Task], work: Callable[[Task], Any], workers: int, lost: Lost
) -> Iterator[tuple[Task, Any]]:
    """See :func:`compute`.

    A death does not tell whose task it was: all that were under way are done again, one at a time,
    so that one that always kills its worker kills no others.
    """
    coming = iter(tasks)
    again: list[tuple[Task, int]] = []  # with how often each was tried
    ended = False
    while not ended or again:
        pool = ProcessPoolExecutor(
            workers, mp_context=multiprocessing.get_context("spawn"), initializer=_started
        )
        under_way: dict[Future[Any], tuple[Task, int]] = {}
        try:
            while True:
                room = 1 if again else AHEAD * workers
                while len(under_way) < room and (again or not ended):
                    if again:
                        task, tried = again.pop()
                    else:
                        try:
                            task, tried = next(coming), 0
                        except StopIteration:
                            ended = True
                            break
                    try:
                        under_way[pool.submit(work, task)] = (task, tried)
                    except BrokenProcessPool:
                        again.append((task, tried))
                        raise
                    if tried:
                        break
                if not under_way:
                    break
                for future in wait(under_way, AWAKE, FIRST_COMPLETED).done:
                    result = future.result()  # a broken pool leaves the task under way
                    task, _ = under_way.pop(future)
                    yield task, result
        except BrokenProcessPool:
            again += [(task, tried + 1) for task, tried in under_way.values()]
        except BaseException:
            _end(pool)
            raise
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
        given_up = [task for task, tried in again if tried >= TRIES]
        again = [(task, tried) for task, tried in again if tried < TRIES]
        for task in given_up:
            yield task, lost(task)


def _end(pool: ProcessPoolExecutor) -> None:
    """End its workers at once: whoever stops a run does not wait for what they do."""
    if hasattr(pool, "kill_workers"):  # from Python 3.14 on
        pool.kill_workers()
        return
    for process in list((pool._processes or {}).values()):
        process.kill()
