"""Simulated drives with every error at once: does the standard deviation of every row hold?

python benchmarks/whole_log.py [--drives 8] [--seed 1] [--machine NAME ...] [--causal]
    [--unknown-lag] [--file MACHINE]

Each error is present in about half of the drives: offsets, unequal gains, dead time with a random
knee, R - 40 to + 60 %, magnet flux and inductances ± 25 %, harmonics, iron loss, heating, currents
late by up to half a sample, clipping, lost samples; courses with stops, reversals, low speed. With
--unknown-lag, half of the logs have a lag of -1, half have 0, and the estimate is told neither.
With --file, the machine file is another one, for example without the saturation of the machine.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from common import degrees_error, heading

import fluxobs
from fluxobs.benchmark.draws import COURSES, MACHINES, every_error
from fluxobs.benchmark.drives import Drive, simulated
from fluxobs.machines import example


@dataclass(frozen=True)
class Task:
    """A drive to estimate, with the lag of its log."""

    drive: Drive
    lag: float
    causal: bool
    lag_is_known: bool
    file: str | None


def resistance(drive: Drive) -> float:
    """Return the true resistance [Ω]; NaN if it changes."""
    if "heat" in drive.values:
        return float("nan")
    return float(example(drive.machine).R_s * drive.values.get("R", 1.0))


def magnet_flux(drive: Drive) -> float:
    """Return the true magnet flux [Wb]; NaN without magnets, and for a cage, whose flux moves."""
    if drive.machine == "induction-2kw2":
        return float("nan")
    return float((example(drive.machine).magnet_flux or np.nan) * drive.values.get("psi", 1.0))


@dataclass(frozen=True)
class Score:
    """Score of a drive; angles in degrees."""

    machine: str
    course: str
    rows: int
    valid: int
    good: int
    within: int
    worst: float
    everywhere: float
    ratio: float
    lag_weight: float
    sure_and_wrong: bool
    parameters: tuple[float, ...]


def late(drive: Drive) -> Drive:
    """Return the drive with the log of a controller whose voltages act a sample later: lag -1."""
    return replace(drive, voltage=np.concatenate([drive.voltage[1:], drive.voltage[-1:]]))


def score(task: Task) -> Score:
    """Estimate a drive and score it."""
    drive = task.drive
    result = fluxobs.estimate(
        (drive.voltage, drive.current),
        task.file or drive.machine,
        sample_time=drive.sample_time,
        lag=task.lag if task.lag_is_known else "auto",
        causal=task.causal,
    )
    error = np.abs(degrees_error(result["theta_e"], drive.theta))
    std, valid = np.degrees(result["theta_e_std"]), result["valid"]
    return Score(
        drive.machine,
        drive.course,
        len(error),
        int(valid.sum()),
        int((valid & (error < 3)).sum()),
        int((valid & (error < 2 * std)).sum()),
        float(error[valid].max(initial=0.0)),
        float(np.sqrt(np.mean(error**2))),
        float(np.mean((error[valid] / std[valid]) ** 2)) if valid.any() else np.nan,
        np.nan if result.lag is None else result.lag.weights[task.lag],
        bool((valid & (error > 10) & (error > 5 * std)).any()),
        tuple(parameter_errors(drive, result.learnt)),
    )


def parameter_errors(drive: Drive, learnt: Any) -> Iterator[float]:
    """Yield the errors of resistance and magnet flux at the end, in standard deviations."""
    if learnt is not None and np.isfinite(resistance(drive)):
        yield abs(learnt.resistance - resistance(drive)) / learnt.resistance_std
    if learnt is not None and np.isfinite(magnet_flux(drive)) and learnt.psi_f_std > 0:
        yield abs(learnt.psi_f - magnet_flux(drive)) / learnt.psi_f_std


def line(title: str, scores: list[Score]) -> str:
    """Return a row of the table."""
    rows = sum(score.rows for score in scores)
    valid = sum(score.valid for score in scores)
    worst = np.array([score.worst for score in scores])
    return (
        f"    {title:22s}{len(scores):5d}{valid / rows:8.1%}"
        f"{sum(score.good for score in scores) / rows:8.1%}"
        f"{sum(score.within for score in scores) / max(valid, 1):9.1%}"
        f"{np.mean(worst > 10):8.1%}{np.mean(worst > 20):7.1%}"
        f"{np.median([score.everywhere for score in scores]):9.2f}"
        f"{np.nanmedian([score.ratio for score in scores]):8.2f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--drives", type=int, default=8, help="per machine and course")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--machine", nargs="+", choices=MACHINES, default=MACHINES)
    parser.add_argument("--causal", action="store_true")
    parser.add_argument("--unknown-lag", action="store_true")
    parser.add_argument("--file", choices=MACHINES, help="machine file of all drives")
    options = parser.parse_args()
    heading("Every row of simulated logs with every error at once")
    print(
        "    machine              drives   valid   <3 deg  2 sigma  >10 deg  >20  rms all "
        "(err/sigma)^2"
    )
    scores: list[Score] = []
    # JAX has threads, which a forked process must not inherit.
    with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
        for machine in options.machine:
            tasks = [
                Task(
                    *(late(drive), -1.0) if options.unknown_lag and n % 2 else (drive, 0.0),
                    *(options.causal, not options.unknown_lag, options.file),
                )
                for course in COURSES
                for n, drive in enumerate(
                    simulated(machine, course, options.drives, options.seed, every_error)
                )
            ]
            own = list(pool.map(score, tasks))
            print(line(machine, own), flush=True)
            scores += own
    print(line("all", scores))
    far = np.array([error for score in scores for error in score.parameters])
    print(
        f"    drives with a valid row beyond 10 deg and 5 sigma: "
        f"{sum(score.sure_and_wrong for score in scores)} of {len(scores)}; R, psi beyond 3 sigma "
        f"at the end: {np.mean(far > 3):.1%} of {len(far)}"
    )
    steady = [score.ratio for score in scores if score.course == "steady"]
    if steady:
        print(f"    (err/sigma)^2 at constant speed and load: median {np.nanmedian(steady):.2f}")
    weights = np.array([score.lag_weight for score in scores])
    weights = weights[np.isfinite(weights)]
    if len(weights):
        print(
            f"    weight of the true lag: mean {np.mean(weights):.2f}, below 0.5 on "
            f"{np.mean(weights < 0.5):.1%}, below 0.05 on {np.mean(weights < 0.05):.1%}"
        )


if __name__ == "__main__":
    main()
