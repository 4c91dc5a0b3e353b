"""Inertia, friction and torque from a log: are they right, and do their standard deviations hold?

python benchmarks/mechanics.py [--drives 8] [--seed 1] [--machine NAME ...] [--load 1.0]
    [--all-errors]

Each drive has its own inertia and friction; the load steps at random times. With --load 0 the shaft
is free, and this is stated (--prior load=0).
Without --all-errors the scales of voltages and currents are right, and the other errors are those
of a data sheet's tolerance (benchmarks/first_hour.py). With it, every error of
benchmarks/whole_log.py is present at once, and common gains of 1 % in voltages and currents.
"""

from __future__ import annotations

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from common import heading

import fluxobs
from fluxobs.benchmark.draws import data_sheet, every_error
from fluxobs.benchmark.drives import Drive, simulated
from fluxobs.campaigns.specification import Specification
from fluxobs.core.arrays import Array
from fluxobs.errors import FluxobsError
from fluxobs.identification.mechanics import UNITS

MACHINES = ("servo-400w", "drone-900kv", "pmsm-2kw2", "ipm-2kw2", "ipm-5kw6", "synrm-6kw7")
#: Standard deviation of a common gain with --all-errors.
GAIN = 0.01


@dataclass(frozen=True)
class Score:
    """Errors of a drive; those of identified parameters relative to the true value and to σ."""

    machine: str
    relative: dict[str, float]
    normalised: dict[str, float]
    torque_rms: float
    torque_within: float
    rigid: bool


def score(given: tuple[Drive, float, float, bool]) -> Score | None:
    """Identify a drive and score it."""
    drive, voltage_gain, current_gain, free = given
    log = (voltage_gain * drive.voltage, current_gain * drive.current)
    try:
        found = fluxobs.identify(
            log,
            drive.machine,
            free="R_s,J,friction",
            priors={"load": 0.0} if free else None,
            sample_time=drive.sample_time,
            lag=0,
        )
    except FluxobsError:
        return None
    if found.mechanics is None or found.run is None:
        return None
    true = dict(zip(UNITS, drive.mechanics, strict=True))
    mechanics = found.mechanics
    identified = [name for name in UNITS if mechanics.identifies(name)]
    run = found.run
    fast = np.abs(run["speed_mech"]) > 0.1 * np.abs(run["speed_mech"]).max()
    rows = run["valid"] & fast
    error = (run["torque"] - drive.torque)[rows]
    rated = true_torque(drive.machine)
    return Score(
        drive.machine,
        {name: mechanics.values[name] / true[name] - 1 for name in identified if true[name] > 0},
        {name: (mechanics.values[name] - true[name]) / mechanics.stds[name] for name in identified},
        float(np.sqrt(np.mean(error**2))) / rated if rows.any() else np.nan,
        float(np.mean(np.abs(error) < 2 * run["torque_std"][rows])) if rows.any() else np.nan,
        abs(mechanics.elastic) < 3,
    )


def true_torque(machine: str) -> float:
    """Return the rated torque [N m]."""
    from fluxobs.campaigns.drives import cell_of

    specification = Specification.model_validate(
        {"name": "torque", "scenarios": 1, "machines": [machine], "observers": ["plain"]}
    )
    return float(cell_of(specification, specification.machines[0]).rated.torque)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--drives", type=int, default=8, help="per machine")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--machine", nargs="+", choices=MACHINES, default=MACHINES)
    parser.add_argument("--load", type=float, default=1.0, help="steps, in shares of the usual")
    parser.add_argument("--all-errors", action="store_true")
    options = parser.parse_args()
    heading("Torque, inertia and friction from a log")

    def draw(rng: np.random.Generator, machine: str) -> dict[str, float]:
        values = (every_error if options.all_errors else data_sheet)(rng, machine)
        return values | {
            "load": options.load,
            "inertia": float(np.exp(rng.uniform(np.log(0.5), np.log(3)))),
            "viscous": rng.uniform(0.01, 0.08),
            "coulomb": rng.uniform(0.01, 0.08),
        }

    print(
        f"    {'machine':16s}{'drives':>7s}"
        + "".join(f"{name:>24s}" for name in UNITS)
        + "  torque"
    )
    scores: list[Score] = []
    with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
        for machine in options.machine:
            drives = simulated(machine, "mixed", options.drives, options.seed, draw=draw)
            rng = np.random.default_rng([options.seed, len(machine)])
            gains: Array = np.exp(GAIN * options.all_errors * rng.standard_normal((len(drives), 2)))
            free = options.load == 0
            tasks = [
                (drive, *gain, free) for drive, gain in zip(drives, gains.tolist(), strict=True)
            ]
            got = [entry for entry in pool.map(score, tasks) if entry is not None]
            report(machine, len(drives), got)
            scores += got
    report("all", len(options.machine) * options.drives, scores)
    rigid = np.mean([entry.rigid for entry in scores])
    print(f"    named as not rigid: {1 - rigid:.0%} (all are rigid)")


def report(machine: str, drives: int, scores: list[Score]) -> None:
    """Print a row: identified drives, rms error and share within 2σ of each parameter."""
    text = f"    {machine:16s}{drives:7d}"
    for name in UNITS:
        relative = np.array([s.relative[name] for s in scores if name in s.relative])
        normalised = np.array([s.normalised[name] for s in scores if name in s.normalised])
        if len(relative):
            rms = np.sqrt(np.mean(relative**2))
            within = np.mean(np.abs(normalised) < 2)
            text += f"{len(relative):6d} {rms:7.1%} {within:8.0%}"
        else:
            text += f"{0:6d}{'':17s}"
    torque = [s.torque_rms for s in scores if np.isfinite(s.torque_rms)]
    within = [s.torque_within for s in scores if np.isfinite(s.torque_within)]
    print(f"{text}  {np.mean(torque):6.2%} {np.mean(within):6.1%}", flush=True)


if __name__ == "__main__":
    main()
