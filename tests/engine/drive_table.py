"""Estimates of engine/estimate.c on simulated drives with every error at once.

    python tests/engine/drive_table.py [--drives 3] [--seed 1] [--truth] [--write]

The drives of benchmarks/whole_log.py with constant inductances, 12,000 rows each, from the estimate
of today. With --truth, the engine starts at the true course and machine: what it finds then is
what its objective knows.
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

from engine.estimates import Estimate, NoEstimate, degrees, estimate, file_of  # noqa: E402
from engine.starts import inductances, rms, started  # noqa: E402
from fluxobs.benchmark.draws import COURSES, every_error  # noqa: E402
from fluxobs.benchmark.drives import Drive, simulated  # noqa: E402
from fluxobs.machines import example  # noqa: E402

MACHINES = ("servo-400w", "drone-900kv", "pmsm-2kw2", "ipm-2kw2")
ROWS = slice(500, 12500)
HEADER = (
    *("", "drives", "rms below 1°", "below 3°", "median (e/σ)²", "2 σ of position"),
    *("error of R", "of L_q", "of ψ", "evaluations"),
)


@dataclass(frozen=True)
class Score:
    """Score of a drive: angles in degrees, errors of parameters in percent."""

    machine: str
    rms: float
    square: float
    within: float
    errors: tuple[float, float, float]
    evaluations: int


def from_truth(drive: Drive) -> Estimate:
    """Estimate a drive from its true angle, resistance, inductances and magnet flux."""
    machine, v = example(drive.machine), drive.values
    u = drive.voltage[ROWS]
    names = ("L_d", "L_q")
    L = (x * v.get(n, v.get("L_s", 1.0)) for x, n in zip(inductances(machine), names, strict=True))
    file = file_of(
        *(machine.R_s * v.get("R", 1.0), *L, machine.psi_f * v.get("psi", 1.0)),
        *(machine.rated_current,),
        lag=(0.0, 0.1),
        voltage=float(np.sqrt(np.nanmean(np.abs(u) ** 2))),
    )
    return estimate(u, drive.current[ROWS], drive.sample_time, file, np.unwrap(drive.theta[ROWS]))


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
        return Score(drive.machine, np.inf, np.inf, 0.0, (np.inf,) * 3, 0)
    error, std = degrees(e.rows["angle"], drive.theta[ROWS]), np.degrees(e.rows["angle_std"])
    true = {
        "resistance": machine.R_s * v.get("R", 1.0),
        "L_q": inductances(machine)[1] * v.get("L_q", v.get("L_s", 1.0)),
        "psi_f": machine.psi_f * v.get("psi", 1.0),
    }
    return Score(
        drive.machine,
        rms(error),
        float(np.mean((error / std) ** 2)),
        float(np.mean(np.abs(error) < 2 * std)),
        tuple(float(100 * abs(np.exp(e.value(n)) / x - 1)) for n, x in true.items()),
        e.evaluations,
    )


def cells(name: str, scores: list[Score]) -> list[str]:
    """Return a row of the table."""
    errors = np.median([s.errors for s in scores], axis=0)
    return [
        name,
        str(len(scores)),
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
    parser.add_argument("--write", action="store_true", help="write docs/numbers/drive_table.json")
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
