"""Campaigns: how long a thousand drives take, what the engine costs, and how it scales.

python benchmarks/campaigns.py [--quick]
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

from common import heading

from fluxobs.campaigns import Specification, campaign, dataset
from fluxobs.campaigns.campaign import fill
from fluxobs.campaigns.dataset import TIMES, Chunk, Dataset, chunk_size
from fluxobs.core.engine import locked

SCENARIOS, WORKERS = 1000, 2


def specification(loop: str, scenarios: int = SCENARIOS) -> Specification:
    """Two seconds at 8 kHz, plain and adaptive, with ten quantities that vary."""
    return Specification(
        machines=["pmsm-2kw2"],
        scenarios=scenarios,
        loop=loop,
        observers=["plain", "adaptive"],
        vary={
            "R": {"normal": [1, 0.1], "within": [0.7, 1.3]},
            "temperature": {"uniform": [0, 100]},
            "gain": {"uniform": [0.99, 1.01]},
            "offset": {"normal": [0, 0.01]},
            "dead_time": {"uniform": [0, 0.01]},
            "noise": 0.003,
        },
    )


def run(loop: str, scheduler: str, workers: int, scenarios: int = SCENARIOS) -> tuple[float, float]:
    """Seconds until the rows are there, and seconds of the workers in chunks; both with what is
    compiled in the cache, by a run before."""
    s = specification(loop, scenarios)
    with tempfile.TemporaryDirectory() as folder:
        found = dataset.create(Path(folder) / "out", s, _size(s))
        from fluxobs.campaigns.chunk import ChunkTask

        started = time.perf_counter()
        with locked(found.folder):
            work = ChunkTask(str(found.folder), s.canonical())
            fill(found, work, workers, scheduler, lambda done, total: None)
        wall = time.perf_counter() - started
        lines = (found.folder / TIMES).read_text().splitlines()
        return wall, sum(float(line.split(",")[2]) for line in lines)


def _size(s: Specification) -> int:
    from fluxobs.campaigns.simulated import lanes_for

    return chunk_size(s, lanes_for(s, 1.25e-4), 1.25e-4)


def nothing(folder: str, chunk: Chunk) -> float:
    """The work on a chunk of scenarios that cost nothing: a file is made, that is all."""
    (Path(folder) / "rows" / chunk.file).touch()
    return 0.0


def driver(scenarios: int) -> None:
    """A million scenarios that cost nothing: the driver's processor time and memory."""
    s = specification("open", scenarios)
    with tempfile.TemporaryDirectory() as folder:
        found: Dataset = dataset.create(Path(folder) / "out", s, 4096)
        usage = resource.getrusage(resource.RUSAGE_SELF)
        before = usage.ru_utime + usage.ru_stime
        with locked(found.folder):
            work = partial(nothing, str(found.folder))
            fill(found, work, WORKERS, "pool", lambda done, total: None)
        usage = resource.getrusage(resource.RUSAGE_SELF)
        spent = usage.ru_utime + usage.ru_stime - before
        print(f"{spent / scenarios * 1e6:.2f} {usage.ru_maxrss / 1024:.0f}")


def measured_driver(scenarios: int) -> tuple[float, float]:
    """The driver in a process of its own: µs a scenario, MiB."""
    done = subprocess.run(
        [sys.executable, __file__, "--driver", str(scenarios)],
        capture_output=True,
        text=True,
        check=True,
    )
    spent, size = done.stdout.split()
    return float(spent), float(size)


def main(quick: bool) -> None:
    count = 256 if quick else SCENARIOS
    heading(
        f"{count} scenarios of 2 s at 8 kHz, plain and adaptive, {os.cpu_count()} processors "
        f"(target for 1000 on two: 60 s open loop, 120 s in the loop, once compiled)"
    )
    for loop in ("open", "closed"):
        s = specification(loop, 64)
        with tempfile.TemporaryDirectory() as folder:  # compiles
            campaign(s, Path(folder) / "out", workers=1, scheduler="pool")
        wall, worked = run(loop, "pool", WORKERS, count)
        idle = 100 * (1 - worked / WORKERS / wall)
        print(
            f"    {loop}: {wall:.1f} s on {WORKERS} workers, {1e3 * worked / count:.0f} ms of "
            f"computing a scenario; start, files and waiting {idle:.0f} % of the workers' time"
        )
    heading(f"Dask: one and two workers on {2 * count} scenarios, start included (target 1.8)")
    walls = [run("open", "local", workers, 2 * count)[0] for workers in (1, 2)]
    print(f"    {walls[0]:.1f} s and {walls[1]:.1f} s: {walls[0] / walls[1]:.2f} times")
    heading("The driver at scenarios that cost nothing (target 50 µs each, constant memory)")
    for scenarios in (10_000, 100_000, 1_000_000):
        spent, size = measured_driver(scenarios)
        print(f"    {scenarios:9,d}: {spent:.2f} µs of processor time each, {size:.0f} MiB at most")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--driver", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.driver:
        driver(options.driver)
    else:
        main(options.quick)
