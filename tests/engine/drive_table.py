"""Estimates of engine/estimate.c on simulated drives with every error at once.

    python tests/engine/drive_table.py [--drives 3] [--seed 1] [--truth] [--write]

The drives of benchmarks/whole_log.py, 12,000 rows each, from the course of the observers. With
--truth, the engine starts at the true course and machine: the objective without a search.
"""

from __future__ import annotations

import argparse
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "benchmarks")]

from numbers_data import Numbers  # noqa: E402

from engine.estimates import NoEstimate, degrees, estimate  # noqa: E402
from engine.machines import machine_file, measured  # noqa: E402
from engine.starts import rms, started  # noqa: E402
from fluxobs.benchmark.draws import COURSES, MACHINES, every_error  # noqa: E402
from fluxobs.benchmark.drives import Drive, simulated  # noqa: E402
from fluxobs.inference.posterior import Posterior  # noqa: E402
from fluxobs.machines import example  # noqa: E402

ROWS = slice(500, 12500)
HEADER = (
    *(
        "",
        "drives",
        "rows with an angle",
        "rms below 1°",
        "below 3°",
        "median (e/σ)²",
        "2 σ of position",
    ),
    *("error of R", "of L_q", "of ψ", "evaluations"),
)


@dataclass(frozen=True)
class Score:
    """Score of the rows of a drive that have an angle [°]; errors of parameters in percent."""

    machine: str
    known: float
    rms: float
    square: float
    within: float
    errors: tuple[float, ...]
    evaluations: int


def from_truth(drive: Drive) -> Posterior:
    """Estimate a drive from its true angle and machine."""
    u, h = drive.voltage[ROWS], drive.sample_time
    volts = float(np.sqrt(np.nanmean(np.abs(u) ** 2)))
    file = machine_file(example(drive.machine), h, voltage=volts, true=drive.values)
    applied, current = measured(u, drive.current[ROWS], h)
    return estimate(applied, current, h, file, np.unwrap(drive.theta[ROWS]))


def score(drive: Drive, truth: bool) -> Score:
    """Estimate a drive and score it."""
    machine, v = example(drive.machine), drive.values
    try:
        if truth:
            e = from_truth(drive)
        else:
            u, i = drive.voltage[ROWS], drive.current[ROWS]
            rated = machine.rated_current
            e = started(u, i, drive.sample_time, machine, rated, (0.0, 0.1), ordinary=True)
    except NoEstimate:
        return Score(drive.machine, 0.0, np.inf, np.inf, 0.0, (np.inf,) * 3, 0)
    known = np.isfinite(e.rows["angle"])
    error = degrees(e.rows["angle"], drive.theta[ROWS])[known]
    std = np.degrees(e.rows["angle_std"])[known]
    true = machine_file(machine, drive.sample_time, true=v).numbers
    pairs = (("resistance", true["R"]), ("L_q", true["L_q"]), ("psi_f", true["psi_f"]))
    return Score(
        drive.machine,
        float(known.mean()),
        rms(error),
        float(np.mean((error / std) ** 2)),
        float(np.mean(np.abs(error) < 2 * std)),
        tuple(float(100 * abs(np.exp(e.value(n)) / x - 1)) if x else 0.0 for n, x in pairs),
        int(e.about["evaluations"]),
    )


def cells(name: str, scores: list[Score]) -> list[str]:
    """Return a row of the table."""
    errors = np.median([s.errors for s in scores], axis=0)
    return [
        name,
        str(len(scores)),
        f"{np.mean([s.known for s in scores]):.0%}",
        *(f"{np.mean([s.rms < most for s in scores]):.0%}" for most in (1, 3)),
        f"{np.median([s.square for s in scores]):.2f}",
        f"{np.mean([s.within for s in scores]):.0%}",
        *(f"{e:.1f} %" for e in errors),
        f"{np.median([s.evaluations for s in scores]):.0f}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--drives", type=int, default=3, help="per machine and course")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--truth", action="store_true")
    parser.add_argument("--write", action="store_true", help="write docs/numbers/NAME.json")
    options = parser.parse_args()
    name = "drive_table_truth" if options.truth else "drive_table"
    sources = ["engine/*.[ch]", "tests/engine/*.py", "src/fluxobs/benchmark/dr*.py"]
    rows, scores = [], []
    # JAX has threads, which a forked process must not inherit.
    pool = ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn"))
    with Numbers(name, sources) as numbers, pool:
        for machine in MACHINES:
            drives = [
                drive
                for course in COURSES
                for drive in simulated(machine, course, options.drives, options.seed, every_error)
            ]
            own = list(pool.map(partial(score, truth=options.truth), drives))
            rows.append(cells(machine, own))
            print("\t".join(rows[-1]), flush=True)
            scores += own
        rows.append(cells("all", scores))
        print("\t".join(rows[-1]))
        numbers.table("drives", HEADER, rows)


if __name__ == "__main__":
    main()
