"""Wall time of `fluxobs estimate` on a CSV of 4000 rows; each run is a new process."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import polars as pl
from common import Drive, heading

from fluxobs.machines import example, example_text


def main() -> None:
    heading("fluxobs estimate on 4000 rows of CSV, imports included (target 1 s)")
    machine = example("servo-400w")
    _, i, _, u = Drive(machine, 800.0, 4j, 1e-4).samples(4001)
    i = i + 0.1 + 0.02 * np.random.default_rng(0).standard_normal(i.shape)
    columns = {"t": np.arange(4000) * 1e-4, "u_alpha": u[1:, 0], "u_beta": u[1:, 1]}
    columns |= {"i_alpha": i[:-1, 0], "i_beta": i[:-1, 1]}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        pl.DataFrame(columns).write_csv(folder / "log.csv")
        (folder / "machine.toml").write_text(example_text("servo-400w"))
        command = [sys.executable, "-m", "fluxobs", "estimate", "log.csv"]
        command += ["--machine", "machine.toml", "--out", "out.parquet"]
        times = []
        for _ in range(7):
            started = time.perf_counter()
            subprocess.run(command, check=True, cwd=folder, stdout=subprocess.DEVNULL)
            times.append(time.perf_counter() - started)
        print(f"    median {np.median(times):.2f} s, best {min(times):.2f} s")


if __name__ == "__main__":
    main()
