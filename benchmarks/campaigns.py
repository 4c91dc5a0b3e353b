"""Campaigns: time for a thousand drives, overhead of the engine, and scaling.

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
    """Return a specification of drives of two seconds at 8 kHz with plain and adaptive observer."""
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
    """Return (wall time of a campaign, computing time of its chunks) [s].

    An earlier run must have filled the cache of compiled code.
    """
    spec = specification(loop, scenarios)
    with tempfile.TemporaryDirectory() as folder:
        created = dataset.create(Path(folder) / "out", spec, _size(spec))
        from fluxobs.campaigns.chunk import ChunkTask

        started = time.perf_counter()
        with locked(created.folder):
            task = ChunkTask(str(created.folder), spec.canonical())
            fill(created, task, workers, scheduler, lambda done, total: None)
        wall = time.perf_counter() - started
        lines = (created.folder / TIMES).read_text().splitlines()
        return wall, sum(float(line.split(",")[2]) for line in lines)


def _size(spec: Specification) -> int:
    from fluxobs.campaigns.simulated import lanes_for

    return chunk_size(spec, lanes_for(spec, 1.25e-4), 1.25e-4)


def empty_task(folder: str, chunk: Chunk) -> float:
    """Do the task of a chunk of empty scenarios: only create the chunk's file."""
    (Path(folder) / "rows" / chunk.file).touch()
    return 0.0


def driver(scenarios: int) -> None:
    """Print the driver's processor time per scenario [µs] and memory [MiB] with empty scenarios."""
    spec = specification("open", scenarios)
    with tempfile.TemporaryDirectory() as folder:
        created: Dataset = dataset.create(Path(folder) / "out", spec, 4096)
        usage = resource.getrusage(resource.RUSAGE_SELF)
        start = usage.ru_utime + usage.ru_stime
        with locked(created.folder):
            task = partial(empty_task, str(created.folder))
            fill(created, task, WORKERS, "pool", lambda done, total: None)
        usage = resource.getrusage(resource.RUSAGE_SELF)
        processor_time = usage.ru_utime + usage.ru_stime - start
        print(f"{processor_time / scenarios * 1e6:.2f} {usage.ru_maxrss / 1024:.0f}")


def measured_driver(scenarios: int) -> tuple[float, float]:
    """Run the driver in a separate process; return µs per scenario and MiB."""
    process = subprocess.run(
        [sys.executable, __file__, "--driver", str(scenarios)],
        capture_output=True,
        text=True,
        check=True,
    )
    microseconds, memory = process.stdout.split()
    return float(microseconds), float(memory)


def main(quick: bool) -> None:
    count = 256 if quick else SCENARIOS
    heading(
        f"{count} scenarios of 2 s at 8 kHz, plain and adaptive, {os.cpu_count()} processors "
        "(target for 1000 scenarios on two processors after compilation: 60 s in open loop, 120 "
        "s in closed loop)"
    )
    for loop in ("open", "closed"):
        spec = specification(loop, 64)
        with tempfile.TemporaryDirectory() as folder:  # fills the cache of compiled code
            campaign(spec, Path(folder) / "out", workers=1, scheduler="pool")
        wall, computing = run(loop, "pool", WORKERS, count)
        idle = 100 * (1 - computing / WORKERS / wall)
        print(
            f"    {loop}: {wall:.1f} s on {WORKERS} workers, {1e3 * computing / count:.0f} ms of "
            f"computing per scenario; start, files and waiting need {idle:.0f} % of the workers' "
            "time"
        )
    heading(
        f"Dask with one and with two workers on {2 * count} scenarios, start included (target "
        "ratio 1.8)"
    )
    walls = [run("open", "local", workers, 2 * count)[0] for workers in (1, 2)]
    print(f"    {walls[0]:.1f} s and {walls[1]:.1f} s: ratio {walls[0] / walls[1]:.2f}")
    heading("The driver with empty scenarios (target 50 µs per scenario, constant memory)")
    for scenarios in (10_000, 100_000, 1_000_000):
        microseconds, memory = measured_driver(scenarios)
        print(
            f"    {scenarios:9,d}: {microseconds:.2f} µs of processor time per scenario, peak "
            f"memory {memory:.0f} MiB"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--driver", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.driver:
        driver(options.driver)
    else:
        main(options.quick)
