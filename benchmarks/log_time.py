"""Processor time of `fluxobs estimate` and `fluxobs check` on one log, imports included.

The log is at 10 kHz: a servo oscillates between ±800 rad/s, with offsets and noise. Each run is a
new process; the time of all its threads counts, and the fastest of three runs. With --write, the
numbers go to docs/numbers/log_time.json.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import polars as pl
from common import heading
from hour import MACHINE
from numbers_data import Numbers

RATE = 10_000  # [Hz]
RUNS, REPEATED = (("estimate", 10_000), ("estimate", 100_000), ("check", 40_000)), 3
#: Logs of a fleet, of ten seconds each.
LOGS = 100_000
#: What the commands load.
ROOMS = "checking cli core estimation examination logs machines observers presentation smoothing"
SOURCES = tuple(f"src/fluxobs/{room}/**/*.py" for room in ROOMS.split())


def write_log(rows: int, path: Path) -> None:
    """Write the record of the drive as CSV."""
    rng = np.random.default_rng(1)
    t = np.arange(rows) / RATE
    speed, rotation = 800 * np.cos(0.5 * t), np.exp(1j * 1600 * np.sin(0.5 * t))
    i = 4j * rotation
    u = 0.36 * i + 0.6e-3 * 4j * 1j * speed * rotation + 0.0125j * speed * rotation
    u[1:] = (u[1:] + u[:-1]) / 2  # mean over the interval that ends at the row: lag 0
    i = i + 0.1 + 0.02 * (rng.standard_normal(rows) + 1j * rng.standard_normal(rows))
    columns = {"t": t, "u_alpha": u.real, "u_beta": u.imag, "i_alpha": i.real, "i_beta": i.imag}
    pl.DataFrame(columns).write_csv(path, float_precision=5)


def times(command: str, rows: int) -> tuple[float, float, float]:
    """Return the time of the processor and of a clock [s], and the size of the output [MB]."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_log(rows, folder / "log.csv")
        (folder / "machine.toml").write_text(MACHINE)
        words = [sys.executable, "-m", "fluxobs", command, "log.csv", "--machine", "machine.toml"]
        words += ["--lag", "0"]
        words += ["--out", "out.parquet"] if command == "estimate" else []
        before, started = os.times(), time.perf_counter()
        # The exit code of `check` is 1 if something deserves attention.
        done = subprocess.run(words, cwd=folder, stdout=subprocess.DEVNULL, check=False)
        waited, after = time.perf_counter() - started, os.times()
        if done.returncode > 1:
            raise SystemExit(f"{' '.join(words)}: exit code {done.returncode}")
        out = folder / "out.parquet"
        size = out.stat().st_size / 1e6 if out.exists() else 0.0
    used = after.children_user + after.children_system
    return used - before.children_user - before.children_system, waited, size


def main() -> None:
    heading("One log at 10 kHz: time of a processor, imports included")
    with Numbers("log_time", SOURCES) as numbers:
        for command, rows in RUNS:
            used, waited, size = min(times(command, rows) for _ in range(REPEATED))
            print(f"    {command}, {rows} rows: {used:.1f} s, {waited:.1f} s by the clock")
            numbers.value(f"{command}_{rows}", used, "{:.1f} s" if used < 10 else "{:.0f} s")
            if command == "estimate":
                numbers.value(f"{command}_{rows}_size", size, "{:.1f} MB")
        estimated, size = (
            numbers.values[key]["value"] for key in ("estimate_100000", "estimate_100000_size")
        )
        numbers.value("fleet", float(f"{LOGS * estimated / 3600:.2g}"), "{:.0f} core-hours")
        numbers.value("fleet_size", LOGS * size / 1e6, "{:.1f} TB")


if __name__ == "__main__":
    main()
