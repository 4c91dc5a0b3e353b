"""A campaign killed at random instants resumes from its files: no row lost, none repeated."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import polars as pl
import pytest

from fluxobs.campaigns.dataset import ROWS, Dataset
from support.trivial import SIZE, drive, specification

TESTS = Path(__file__).parents[2]
SCENARIOS = 20_000
#: Number of kills of a run on this machine; with the cluster's kills, there are more than twenty.
KILLS = 16
#: Seconds within which a run must write a file, even on a slow machine.
PATIENCE = 120


def start(*arguments: str, stderr: Path | None = None) -> subprocess.Popen[bytes]:
    """Start a Python program in a new process group; write its stderr to a file."""
    environment = os.environ | {"PYTHONPATH": str(TESTS)}
    with Path(stderr or os.devnull).open("wb") as handle:
        return subprocess.Popen(
            [sys.executable, *arguments],
            env=environment,
            start_new_session=True,
            stdout=subprocess.DEVNULL,
            stderr=handle,
        )


def children(pid: int) -> list[int]:
    """Return the descendants of a process, such as workers."""
    descendants = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(fields[1]) == pid:
                descendants += [int(entry.name), *children(int(entry.name))]
    return descendants


def kill(pid: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


def reference(folder: Path) -> pl.DataFrame:
    """Write and return the rows of an undisturbed run, without the engine."""
    from support.trivial import Trivial

    dataset = Dataset(folder, specification(SCENARIOS), SIZE)
    (folder / ROWS).mkdir(parents=True)
    work = Trivial(str(folder), pause=0.0)
    for chunk in dataset.chunks():
        work(chunk)
    return dataset.rows()


def check_equal(killed: Path, tmp_path: Path) -> None:
    """Assert that every file equals that of an undisturbed run, byte for byte."""
    reference(tmp_path / "undisturbed")
    names = {path.name for path in (tmp_path / "undisturbed" / ROWS).iterdir()}
    assert {path.name for path in (killed / ROWS).iterdir()} == names  # no unfinished file is left
    for name in names:
        expected = (tmp_path / "undisturbed" / ROWS / name).read_bytes()
        assert (killed / ROWS / name).read_bytes() == expected
    numbers = Dataset(killed, specification(SCENARIOS), SIZE).rows()["number"]
    assert numbers.to_list() == list(range(SCENARIOS))


def count_files(folder: Path) -> int:
    rows = folder / ROWS
    return sum(1 for _ in rows.glob("*.parquet")) if rows.exists() else 0


def wait_for_more(folder: Path, run: subprocess.Popen[bytes], stderr: Path) -> None:
    """Wait until a run has written another file, or has ended."""
    before, end = count_files(folder), time.monotonic() + PATIENCE
    while count_files(folder) <= before and run.poll() is None and time.monotonic() < end:
        time.sleep(0.02)
    if time.monotonic() >= end:
        os.killpg(run.pid, signal.SIGKILL)
        run.wait()
    assert run.poll() in (None, 0), stderr.read_text()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_kills_of_driver_and_workers(tmp_path: Path) -> None:
    rng, folder, stderr = random.Random(1), tmp_path / "killed", tmp_path / "stderr"
    folder.mkdir()
    interrupted = 0
    while interrupted < KILLS:
        if count_files(folder) == SCENARIOS // SIZE:  # all done: remove half of the files
            for path in list((folder / ROWS).iterdir())[::2]:
                path.unlink()
        trivial = ("-m", "support.trivial", str(folder), str(SCENARIOS), "pool", "2")
        run = start(*trivial, stderr=stderr)
        wait_for_more(folder, run, stderr)
        time.sleep(0.3 * rng.random())
        below = children(run.pid)
        if run.poll() is None:
            interrupted += 1
        kill(run.pid if rng.random() < 0.5 or not below else rng.choice(below))
        time.sleep(0.3 * rng.random())
        kill(run.pid)
        run.wait()
        end = time.monotonic() + 10
        while any(Path(f"/proc/{pid}").exists() for pid in below) and time.monotonic() < end:
            time.sleep(0.05)
        assert not [pid for pid in below if Path(f"/proc/{pid}").exists()]  # no orphans
    drive(folder, SCENARIOS, "pool", 2)
    check_equal(folder, tmp_path)


@contextmanager
def cluster(port: int) -> Iterator[tuple[subprocess.Popen[bytes], list[subprocess.Popen[bytes]]]]:
    """Run a scheduler and two workers in separate processes."""
    dask = ("-m", "distributed.cli.dask_scheduler")
    scheduler = start(*dask, "--port", str(port), "--no-dashboard", "--host", "127.0.0.1")
    workers = [
        start(
            *("-m", "distributed.cli.dask_worker", f"tcp://127.0.0.1:{port}"),
            *("--nthreads", "1", "--no-dashboard", "--death-timeout", str(PATIENCE)),
        )
        for _ in range(2)
    ]
    try:
        yield scheduler, workers
    finally:
        for process in (scheduler, *workers):
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def free_port() -> int:
    import socket

    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        return int(server.getsockname()[1])


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_kills_of_a_cluster(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    rng, folder, stderr = random.Random(2), tmp_path / "killed", tmp_path / "stderr"
    folder.mkdir()
    for victim in ("driver", "worker", "scheduler", "worker", "scheduler"):
        port = free_port()
        with cluster(port) as (scheduler, workers):
            address = f"tcp://127.0.0.1:{port}"
            trivial = ("-m", "support.trivial", str(folder), str(SCENARIOS), address, "2")
            run = start(*trivial, stderr=stderr)
            wait_for_more(folder, run, stderr)
            time.sleep(0.5 * rng.random())
            if victim == "driver":
                kill(run.pid)
            elif victim == "scheduler":
                kill(scheduler.pid)
                run.wait(PATIENCE)  # the run exits with an error
                assert run.returncode != 0
            else:
                kill(rng.choice(children(workers[0].pid) or [workers[0].pid]))
                time.sleep(1.0)
            kill(run.pid)
            run.wait()
    drive(folder, SCENARIOS, "pool", 2)
    check_equal(folder, tmp_path)
