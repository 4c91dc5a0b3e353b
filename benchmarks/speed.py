"""Time per sample of `run` with all outputs, on one core: for one record, and for a batch."""

from __future__ import annotations

import time

import numpy as np
from common import Drive, heading
from numpy.typing import NDArray

from fluxobs import LeastSquaresObserver
from fluxobs.campaigns.observed import TOGETHER
from fluxobs.machines import SurfacePMSM, example

ROWS, REPEATS = 200_000, 9
LENGTHS, BATCH = (1_000, 16_000), 32
Array = NDArray[np.float64]


def main() -> None:
    heading("Time per sample (target 350 ns on one core)")
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
    together(machine, u, i)


def together(machine: SurfacePMSM, u: Array, i: Array) -> None:
    """Compare a batch with single runs of its records, on one core.

    The eleven outputs of long records do not fit into the caches.
    """
    heading("Batch of 32 records, one core (target 60 ns in double, 30 in single precision)")
    rng = np.random.default_rng(1)
    for rows in LENGTHS:
        voltage = np.broadcast_to(u[:rows], (BATCH, rows, 2)).copy()
        current = i[:rows] + 0.02 * rng.standard_normal(voltage.shape)
        for precision in ("double", "single"):
            observer = LeastSquaresObserver.for_machine(
                machine, sample_time=5e-5, precision=precision
            )
            single_times, batch_times = [], []
            for _ in range(REPEATS):
                started = time.perf_counter()
                for lane in range(BATCH):
                    observer.run(voltage[lane], current[lane])
                single_times.append(time.perf_counter() - started)
                started = time.perf_counter()
                for first in range(0, BATCH, TOGETHER):
                    lanes = slice(first, first + TOGETHER)
                    observer.run(voltage[lanes], current[lanes], threads=1)
                batch_times.append(time.perf_counter() - started)
            batch_ns, single_ns = (
                1e9 * min(times) / BATCH / rows for times in (batch_times, single_times)
            )
            print(
                f"    {rows} rows, {precision}: {batch_ns:.0f} ns per sample and record; in single "
                f"runs {single_ns:.0f} ns, {single_ns / batch_ns:.1f} times as long"
            )


if __name__ == "__main__":
    main()
