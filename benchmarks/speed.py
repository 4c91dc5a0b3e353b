"""Time a sample of `run`, all that it returns, on one core; double, single, and a batch."""

from __future__ import annotations

import os
import time

import numpy as np
from common import Drive, heading

from fluxobs import LeastSquaresObserver
from fluxobs.machines import example

ROWS, REPEATS = 200_000, 9


def main() -> None:
    heading("Time a sample (target 350 ns on one core)")
    machine = example("servo-400w")
    drive = Drive(machine, 800.0, 4j, 5e-5)
    _, i, _, u = drive.samples(ROWS)
    i = i + 0.1 + 0.02 * np.random.default_rng(0).standard_normal(i.shape)
    for precision in ("double", "single"):
        observer = LeastSquaresObserver.for_machine(machine, sample_time=5e-5, precision=precision)
        times = []
        for _ in range(REPEATS):
            started = time.perf_counter()
            observer.run(u, i)
            times.append((time.perf_counter() - started) / ROWS * 1e9)
        print(f"    {precision}: median {np.median(times):.0f} ns, best {min(times):.0f} ns")
    observer = LeastSquaresObserver.for_machine(machine, sample_time=5e-5)
    lanes = 8
    both = np.broadcast_to(u, (lanes, *u.shape)), np.broadcast_to(i, (lanes, *i.shape))
    started = time.perf_counter()
    observer.run(*both)
    each = (time.perf_counter() - started) / ROWS / lanes * 1e9
    print(f"    batch of {lanes} on {os.cpu_count()} cores: {each:.0f} ns a sample and record")


if __name__ == "__main__":
    main()
