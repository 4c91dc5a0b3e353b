"""Killed at random instants, a campaign goes on where it was: nothing twice, nothing lost."""

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
#: Kills of a run by itself on this machine; with those of a cluster there are more than twenty.
KILLS = 16
#: Seconds in which a run has to get on, on a slow machine too.
PATIENCE = 120


def started(*arguments: str, said: Path | None = None) -> subprocess.Popen[bytes]:
    """A Python program, in a group of its own; what it says of errors goes to a file."""
    environment = os.environ | {"PYTHONPATH": str(TESTS)}
    with Path(said or os.devnull).open("wb") as errors:
        return subprocess.Popen(
            [sys.executable, *arguments],
            env=environment,
            start_new_session=True,
            stdout=subprocess.DEVNULL,
            stderr=errors,
        )


def children(pid: int) -> list[int]:
    """Processes below a process, workers for example."""
    out = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(fields[1]) == pid:
                out += [int(entry.name), *children(int(entry.name))]
    return out


def kill(pid: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


def reference(folder: Path) -> pl.DataFrame:
    """The rows of an undisturbed run, made without any engine."""
    from support.trivial import Trivial

    found = Dataset(folder, specification(SCENARIOS), SIZE)
    (folder / ROWS).mkdir(parents=True)
    work = Trivial(str(folder), pause=0.0)
    for chunk in found.chunks():
        work(chunk)
    return found.rows()


def check_equal(killed: Path, tmp_path: Path) -> None:
    """Every file of the killed run equals that of the undisturbed one, byte for byte."""
    reference(tmp_path / "undisturbed")
    names = {path.name for path in (tmp_path / "undisturbed" / ROWS).iterdir()}
    assert {path.name for path in (killed / ROWS).iterdir()} == names  # nothing unfinished is left
    for name in names:
        whole = (tmp_path / "undisturbed" / ROWS / name).read_bytes()
        assert (killed / ROWS / name).read_bytes() == whole
    numbers = Dataset(killed, specification(SCENARIOS), SIZE).rows()["number"]
    assert numbers.to_list() == list(range(SCENARIOS))


def done(folder: Path) -> int:
    place = folder / ROWS
    return sum(1 for _ in place.glob("*.parquet")) if place.exists() else 0


def wait_for_more(folder: Path, run: subprocess.Popen[bytes], said: Path) -> None:
    """Wait until a run has written a file, or has done all that was missing."""
    before, end = done(folder), time.monotonic() + PATIENCE
    while done(folder) <= before and run.poll() is None and time.monotonic() < end:
        time.sleep(0.02)
    if time.monotonic() >= end:
        os.killpg(run.pid, signal.SIGKILL)
        run.wait()
    assert run.poll() in (None, 0), said.read_text()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_kills_of_driver_and_workers(tmp_path: Path) -> None:
    rng, folder, said = random.Random(1), tmp_path / "killed", tmp_path / "said"
    folder.mkdir()
    interrupted = 0
    while interrupted < KILLS:
        if done(folder) == SCENARIOS // SIZE:  # all done: begin once more with half of it
            for path in list((folder / ROWS).iterdir())[::2]:
                path.unlink()
        trivial = ("-m", "support.trivial", str(folder), str(SCENARIOS), "pool", "2")
        run = started(*trivial, said=said)
        wait_for_more(folder, run, said)
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
    """A scheduler and two workers in processes of their own."""
    dask = ("-m", "distributed.cli.dask_scheduler")
    scheduler = started(*dask, "--port", str(port), "--no-dashboard", "--host", "127.0.0.1")
    workers = [
        started(
            *("-m", "distributed.cli.dask_worker", f"tcp://127.0.0.1:{port}"),
            *("--nthreads", "1", "--no-dashboard", "--death-timeout", str(PATIENCE)),
        )
        for _ in range(2)
    ]
    try:
        yield scheduler, workers
    finally:
        for one in (scheduler, *workers):
            with suppress(ProcessLookupError):
                os.killpg(one.pid, signal.SIGKILL)
            one.wait()


def free_port() -> int:
    import socket

    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_kills_of_a_cluster(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    rng, folder, said = random.Random(2), tmp_path / "killed", tmp_path / "said"
    folder.mkdir()
    for victim in ("driver", "worker", "scheduler", "worker", "scheduler"):
        port = free_port()
        with cluster(port) as (scheduler, workers):
            address = f"tcp://127.0.0.1:{port}"
            trivial = ("-m", "support.trivial", str(folder), str(SCENARIOS), address, "2")
            run = started(*trivial, said=said)
            wait_for_more(folder, run, said)
            time.sleep(0.5 * rng.random())
            if victim == "driver":
                kill(run.pid)
            elif victim == "scheduler":
                kill(scheduler.pid)
                run.wait(PATIENCE)  # it notices, and says so
                assert run.returncode != 0
            else:
                kill(rng.choice(children(workers[0].pid) or [workers[0].pid]))
                time.sleep(1.0)
            kill(run.pid)
            run.wait()
    drive(folder, SCENARIOS, "pool", 2)
    check_equal(folder, tmp_path)
