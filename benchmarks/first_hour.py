"""A stranger's log: the first command with nothing but a data sheet, on random drives.

python benchmarks/first_hour.py [--drives 20] [--seed 1] [--machine NAME ...]

Each drive of a tolerance (R -10 to +25 %, magnet flux and inductances +-8 %) has offsets, gains,
noise, dead time, load steps and stops. Its log is a CSV file with the voltages as the controller
computed them, shifted by a lag of -2, -1, 0 or +1 samples, half of them with the angle of an
encoder. The machine file has the values of the data sheet; the lag is not stated.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import polars as pl
from common import degrees_error, heading

import fluxobs
from fluxobs.benchmark.draws import data_sheet
from fluxobs.benchmark.drives import Drive, simulated
from fluxobs.core.arrays import Array

MACHINES = ("servo-400w", "drone-900kv", "pmsm-2kw2", "ipm-2kw2", "ipm-5kw6", "synrm-6kw7")
LAGS = (-2, -1, 0, 1)
#: Rows above this share of the fastest speed of the log count as moving.
MOVING = 0.1


def moved(voltage: Array, lag: int) -> Array:
    """Return the voltages of a log with this lag."""
    if lag == 0:
        return voltage
    if lag > 0:
        return np.concatenate([voltage[:1].repeat(lag), voltage[:-lag]])
    return np.concatenate([voltage[-lag:], voltage[-1:].repeat(-lag)])


@dataclass(frozen=True)
class Log:
    """A CSV file of a drive, and what is true."""

    drive: Drive
    path: Path
    lag: int
    encoder: bool


def written(drive: Drive, folder: Path, number: int, lag: int, encoder: bool) -> Log:
    """Write the log of a drive."""
    voltage, missing = moved(drive.voltage, lag), np.isnan(drive.current)
    columns = {
        "Time [s]": drive.sample_time * np.arange(len(voltage)),
        "u_alpha": voltage.real,
        "u_beta": voltage.imag,
        "i_alpha": drive.current.real,
        "i_beta": np.where(missing, np.nan, drive.current.imag),
    }
    if encoder:
        resolution = 2 * np.pi / 4096
        columns["theta_e"] = np.round(np.mod(drive.theta, 2 * np.pi) / resolution) * resolution
    path = folder / f"{drive.machine}-{number}.csv"
    pl.DataFrame(columns).write_csv(path, float_precision=6)
    return Log(drive, path, lag, encoder)


@dataclass(frozen=True)
class Score:
    """Score of a log; angles in degrees."""

    log: Log
    valid: float
    moving: float
    rms: float
    std: float
    worst: float
    ratio: float
    within: float
    lag: float
    weight: float
    seconds: float


def score(log: Log) -> Score:
    """Estimate a log and score it."""
    began = time.perf_counter()
    result = fluxobs.estimate(log.path, log.drive.machine)
    seconds = time.perf_counter() - began
    error = np.abs(degrees_error(result["theta_e"], log.drive.theta))
    std, valid = np.degrees(result["theta_e_std"]), result["valid"]
    true_speed = np.abs(np.gradient(np.unwrap(log.drive.theta)))
    fast = true_speed > MOVING * true_speed.max()
    some = valid.any()
    return Score(
        log,
        float(valid.mean()),
        float(valid[fast].mean()),
        float(np.sqrt(np.mean(error[valid] ** 2))) if some else np.nan,
        float(np.sqrt(np.mean(std[valid] ** 2))) if some else np.nan,
        float(error[valid].max(initial=0.0)),
        float((error[valid] / std[valid]).max(initial=0.0)),
        float(np.mean(error[valid] < 2 * std[valid])) if some else np.nan,
        np.nan if result.lag is None else result.lag.lag,
        np.nan if result.lag is None else result.lag.weights.get(float(log.lag), 0.0),
        seconds,
    )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--drives", type=int, default=20, help="per machine")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--machine", nargs="+", choices=MACHINES, default=MACHINES)
    options = parser.parse_args()
    heading("The first command on a stranger's log")
    print(
        "    machine          lag  enc   valid  moving    rms  sigma  worst  err/s  2 sigma  "
        "lag found (weight of the true one)"
    )
    scores: list[Score] = []
    with (
        tempfile.TemporaryDirectory() as name,
        ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool,
    ):
        for machine in options.machine:
            drives = simulated(machine, "mixed", options.drives, options.seed, draw=data_sheet)
            logs = [
                written(drive, Path(name), n, LAGS[n % 4], n // 4 % 2 == 1)
                for n, drive in enumerate(drives)
            ]
            for entry in pool.map(score, logs):
                scores.append(entry)
                encoder = "yes" if entry.log.encoder else "no"
                print(
                    f"    {machine:16s}{entry.log.lag:+4d}{encoder:>5s}"
                    f"{entry.valid:8.1%}{entry.moving:8.1%}{entry.rms:7.2f}{entry.std:7.2f}"
                    f"{entry.worst:7.2f}{entry.ratio:7.2f}{entry.within:9.1%}"
                    f"  {entry.lag:+.0f} ({entry.weight:.2f})",
                    flush=True,
                )
    far = [entry for entry in scores if not entry.ratio <= 3]
    few = [entry for entry in scores if entry.moving < 0.6]
    seconds = np.median([entry.seconds for entry in scores])
    print(
        f"    beyond 3 sigma on a valid row: {len(far)} of {len(scores)}; valid on less than 60 % "
        f"of the moving rows: {len(few)}; median time {seconds:.1f} s"
    )


if __name__ == "__main__":
    main()
