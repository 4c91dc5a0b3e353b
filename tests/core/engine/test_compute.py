"""Tasks in other processes: results, errors, worker deaths, and the folder of results."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import polars as pl
import pytest

from fluxobs.core.engine import compute, locked, write_part
from fluxobs.errors import FluxobsError, UsageError
from support import tasks

SCHEDULERS = ["pool", "local"]


#: Dask takes seconds to replace a dead worker.
DYING = [
    pytest.param(name, marks=pytest.mark.slow if name == "local" else ()) for name in SCHEDULERS
]


@pytest.fixture(params=SCHEDULERS)
def scheduler(request: pytest.FixtureRequest) -> str:
    if request.param == "local":
        pytest.importorskip("distributed")
    return str(request.param)


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """A Dask cluster whose workers are threads: they start at once."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, protocol="tcp", dashboard_address=":0"
    ) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(params=["pool", "address"])
def running(request: pytest.FixtureRequest) -> str:
    """The pool, or the address of a cluster that is running."""
    return "pool" if request.param == "pool" else str(request.getfixturevalue("address"))


def test_every_task_once(running: str) -> None:
    results = sorted(compute(range(50), tasks.square, 2, running))
    assert results == [(k, k * k) for k in range(50)]


def test_no_tasks(running: str) -> None:
    assert list(compute([], tasks.square, 2, running)) == []


def test_an_error_in_a_task_reaches_the_driver(running: str) -> None:
    with pytest.raises(FluxobsError, match="no room for 7"):
        list(compute(range(10), tasks.refuse_seven, 2, running))


@pytest.mark.parametrize("scheduler", DYING, indirect=True)
def test_a_task_that_kills_its_worker_once_is_done_again(scheduler: str, tmp_path: Path) -> None:
    work = partial(tasks.die_once, str(tmp_path))
    assert sorted(compute(range(6), work, 2, scheduler)) == [(k, k) for k in range(6)]
    assert (tmp_path / "died").exists()


@pytest.mark.parametrize("scheduler", DYING, indirect=True)
def test_a_task_that_always_kills_its_worker_ends_the_run(scheduler: str) -> None:
    with pytest.raises(FluxobsError, match="its worker died 5 times"):
        list(compute([3], tasks.die, 1, scheduler))


def test_a_run_ends_when_no_worker_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """The only worker dies, and no worker replaces it."""
    pytest.importorskip("distributed")
    import distributed

    from fluxobs.core.engine import cluster

    async def close(nanny: distributed.Nanny, exitcode: int) -> None:
        await nanny.close()

    monkeypatch.setattr(cluster, "ABANDONED", 1)
    monkeypatch.setattr(cluster, "PATIENCE", 2)
    monkeypatch.setattr(distributed.Nanny, "_on_worker_exit", close)
    with pytest.raises(FluxobsError, match="no worker is left; run the same command"):
        list(compute([3], tasks.die, 1))


def test_tasks_are_taken_as_workers_become_free() -> None:
    taken = 0

    def counted():
        nonlocal taken
        for k in range(100):
            taken += 1
            yield k

    for done, _ in enumerate(compute(counted(), tasks.square, 2, "pool"), 1):
        assert taken <= done + 2 * 2


def test_workers_have_one_thread_and_a_cache() -> None:
    names = ("OMP_NUM_THREADS", "POLARS_MAX_THREADS", "JAX_COMPILATION_CACHE_DIR")
    before = dict(os.environ)
    ((_, values),) = compute([names], tasks.environment, 1, "pool")
    assert values[1] == "1"
    assert values[2]
    assert dict(os.environ) == before


def test_scheduler_is_a_name_or_an_address() -> None:
    with pytest.raises(UsageError, match="tcp://host:8786"):
        list(compute([1], tasks.square, 1, "loca"))
    with pytest.raises(UsageError, match="workers must be at least 1"):
        list(compute([1], tasks.square, 0))


def test_no_scheduler_at_the_address(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    from fluxobs.core.engine import cluster

    monkeypatch.setattr(cluster, "PATIENCE", 1)
    with pytest.raises(FluxobsError, match="no scheduler with workers found"):
        list(compute([1], tasks.square, 1, "tcp://127.0.0.1:9"))


def test_one_run_at_a_time_in_a_folder(tmp_path: Path) -> None:
    unfinished = tmp_path / "rows" / ".00.parquet.abc.unfinished"
    unfinished.parent.mkdir()
    unfinished.write_text("half")
    with locked(tmp_path):
        assert not unfinished.exists()
        with pytest.raises(FluxobsError, match="another run uses this folder"), locked(tmp_path):
            pass
    with locked(tmp_path):
        pass


def test_a_file_is_complete_or_absent(tmp_path: Path) -> None:
    frame = pl.DataFrame({"a": [1.5, 2.5]})
    write_part(frame, tmp_path / "a.parquet")
    assert pl.read_parquet(tmp_path / "a.parquet").equals(frame)
    assert [path.name for path in tmp_path.iterdir()] == ["a.parquet"]


def test_a_full_disk_leaves_no_file(tmp_path: Path) -> None:
    program = (
        "import resource, signal, sys, polars as pl, random\n"
        "from pathlib import Path\n"
        "from fluxobs.core.engine import write_part\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))\n"
        "frame = pl.DataFrame({'a': [random.random() for _ in range(100000)]})\n"
        "try:\n"
        "    write_part(frame, Path(sys.argv[1]) / 'a.parquet')\n"
        "except ValueError as error:\n"
        "    sys.exit(str(error))\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert run.returncode == 1
    assert "a.parquet: cannot be written" in run.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("scheduler", DYING, indirect=True)
def test_giving_up_a_task_does_not_stop_the_others(scheduler: str) -> None:
    results = dict(compute(range(8), tasks.die_at_three, 2, scheduler, lambda task: "lost"))
    assert results == {k: "lost" if k == 3 else k for k in range(8)}
