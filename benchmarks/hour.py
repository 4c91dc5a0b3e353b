"""Wall time and memory of `fluxobs estimate` on an hour at 20 kHz, 72 million rows of Parquet.

python benchmarks/hour.py [--hours 1.0] [--folder DIR]
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import polars as pl
from common import heading
from polars.io.plugins import register_io_source

RATE, BATCH = 20_000, 1_000_000
MACHINE = """kind = "surface-pmsm"
R_s = 0.36
L_s = 0.6e-3
n_p = 4
psi_f = 0.0125
rated_current = 12.0
"""


def batches(rows: int) -> Iterator[pl.DataFrame]:
    """Yield a record of a drive that oscillates between ±800 rad/s, with offsets and noise."""
    rng = np.random.default_rng(1)
    for start in range(0, rows, BATCH):
        t = np.arange(start, min(start + BATCH, rows)) / RATE
        speed = 800 * np.cos(0.5 * t)
        rotation = np.exp(1j * 1600 * np.sin(0.5 * t))
        i = 4j * rotation
        u = 0.36 * i + 0.6e-3 * 4j * 1j * speed * rotation + 0.0125j * speed * rotation
        i = i + 0.1 + 0.02 * (rng.standard_normal(len(t)) + 1j * rng.standard_normal(len(t)))
        yield pl.DataFrame(
            {"t": t, "u_alpha": u.real, "u_beta": u.imag, "i_alpha": i.real, "i_beta": i.imag}
        )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--folder", type=Path)
    options = parser.parse_args()
    rows = int(options.hours * 3600 * RATE)
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        folder = Path(name)
        schema = dict.fromkeys(("t", "u_alpha", "u_beta", "i_alpha", "i_beta"), pl.Float64)
        register_io_source(lambda *_: batches(rows), schema=schema).sink_parquet(
            folder / "log.parquet"
        )
        (folder / "machine.toml").write_text(MACHINE)
        started = time.perf_counter()
        command = [sys.executable, "-m", "fluxobs", "estimate", folder / "log.parquet"]
        command += [
            "--lag",
            "0",
            "--machine",
            folder / "machine.toml",
            "--out",
            folder / "estimates.parquet",
        ]
        subprocess.run(command, check=True)
        wall = time.perf_counter() - started
        memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**20
        heading(f"{rows} rows of Parquet (target for 72 million: 180 s, 1 GB)")
        sizes = [(folder / n).stat().st_size / 2**30 for n in ("log.parquet", "estimates.parquet")]
        print(f"    {wall:.1f} s wall, {1e9 * wall / rows:.0f} ns per row, peak {memory:.2f} GiB")
        print(f"    log {sizes[0]:.2f} GiB, estimates {sizes[1]:.2f} GiB")


if __name__ == "__main__":
    main()
