"""Estimates of engine/estimate.c: calibration, noise in a closed loop, and measured logs.

    python tests/engine/estimate_table.py [--drives 40] [--write]

The measured logs are those of benchmarks/measured.py; without them, their tables are skipped.
"""

from __future__ import annotations

import argparse
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import polars as pl

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "benchmarks")]

from common import MEASURED  # noqa: E402
from measured import LAYOUT, MACHINE, Q8  # noqa: E402
from numbers_data import Numbers  # noqa: E402

from engine.estimates import NoEstimate, degrees  # noqa: E402
from engine.likelihood import Array  # noqa: E402
from engine.loop import INTERIOR, SURFACE, Conditions, simulated  # noqa: E402
from engine.starts import rms, started  # noqa: E402
from fluxobs import InteriorPMSM, SurfacePMSM  # noqa: E402
from fluxobs.inference.posterior import Posterior  # noqa: E402

RATED = 12.0
#: Name and conditions of the closed loops; files are 10 to 20 % wrong.
LOSSY = replace(SURFACE, loss=0.05)
LOOPS = {
    "surface": LOSSY,
    "interior": replace(INTERIOR, loss=0.05),
    **{
        f"surface, encoder, noise {share} %": replace(
            LOSSY, noise=RATED * share / 100, encoder=True
        )
        for share in (0.08, 0.25, 0.8)
    },
    "surface, encoder, lag −1": replace(LOSSY, lag=1, bandwidth=0.2, encoder=True),
}
LOOP_HEADER = (
    *("", "with an estimate", "rms", "position", "speed", "R", "L_d", "L_q", "ψ"),
    "mean error of L_q",
)
MEASURED_HEADER = ("log", "rms", "mean", "largest", "in halves", "in quarters", "L", "ψ")
#: Rows of a measured log, of its halves and of its quarters.
WHOLE = (0, 4000)
PARTS = [[(k, k + n) for k in range(0, 4000, n)] for n in (2000, 1000)]


def attempted(*arguments: Any) -> Posterior | None:
    """Return the estimate of a drive, None without one."""
    try:
        return started(*arguments)
    except NoEstimate:
        return None


def squares(c: Conditions, drives: int) -> list[dict[str, float]]:
    """Return (error/σ)² of each drive with an estimate, and the error of L_q in percent."""
    record = simulated(c, drives, seed=11)
    given = {"R_s": 1.15 * c.R, "psi_f": 1.1 * c.psi, "n_p": 4, "rated_current": RATED}
    machine = (
        SurfacePMSM(**given, L_s=0.8 * c.L_d)
        if c.L_d == c.L_q
        else InteriorPMSM(**given, L_d=0.8 * c.L_d, L_q=0.8 * c.L_q)
    )
    true = {"R": c.R, "L_d": c.L_d, "L_q": c.L_q, "psi_f": c.psi}
    names = {"R": "resistance"}
    # JAX has threads, which a forked process must not inherit.
    with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
        done = list(
            pool.map(
                attempted,
                *(record.voltage.T, record.current.T, repeat(1e-4), repeat(machine)),
                *(repeat(RATED), repeat((float(c.lag), 0.3))),
            )
        )
    rows = []
    for k, e in enumerate(done):
        if e is None:
            continue
        known = np.isfinite(e.rows["angle"])
        of = {name: values[known] for name, values in e.rows.items()}
        error = degrees(of["angle"], record.angle[known, k])
        speed = np.gradient(record.angle[:, k], 1e-4)[known]
        row = {
            "position": float(np.mean((error / np.degrees(of["angle_std"])) ** 2)),
            "speed": float(np.mean(((of["speed"] - speed) / of["speed_std"]) ** 2)),
            "rms": rms(error),
            "L_q error": float(100 * (np.exp(e.value("L_q")) / c.L_q - 1)),
        }
        for name, value in true.items():
            own = names.get(name, name)
            row[name] = ((e.value(own) - np.log(value)) / e.std(own)) ** 2
        rows.append(row)
    return rows


def loop_row(name: str, rows: list[dict[str, float]], drives: int) -> list[str]:
    """Return the cells of a closed loop."""

    def mean(key: str) -> float:
        return float(np.mean([row[key] for row in rows]))

    std = float(np.std([row["L_q error"] for row in rows]))
    return [
        name,
        f"{len(rows)} of {drives}",
        f"{np.sqrt(np.mean([row['rms'] ** 2 for row in rows])):.2f}°",
        *(f"{mean(key):.2f}" for key in ("position", "speed", "R", "L_d", "L_q", "psi_f")),
        f"{mean('L_q error'):+.1f} ± {std / np.sqrt(len(rows)):.1f} %",
    ]


def part(path: Path, rows: tuple[int, int]) -> tuple[Array, Posterior]:
    """Return the errors of the angle [°] on rows of a measured log, and the estimate."""
    table = pl.read_csv(path)
    u, i = (table.select(f"{x}_a", f"{x}_b").to_numpy() @ [1, 1j] * Q8 for x in "ui")
    true = MACHINE.n_p * Q8 * table["AngMes"].to_numpy()
    own = slice(*rows)
    # The published data have no rated current: four times the std of the current.
    rated, h = float(4 * np.std(i[own])), float(LAYOUT["sample_time"])
    # The voltages act a row later than the log says.
    done = started(u[own], i[own], h, MACHINE, rated, (1.0, 0.1), ordinary=True)
    return degrees(done.rows["angle"], true[own]), done


def measured_row(path: Path) -> list[str]:
    """Return the cells of a measured log: the whole, and the largest errors of its parts."""
    error, whole = part(path, WHOLE)
    halves, quarters = (
        max(float(np.nanmax(np.abs(part(path, rows)[0]))) for rows in parts) for parts in PARTS
    )
    L = 1e3 * np.exp(whole.value("L_d"))
    return [
        path.stem,
        f"{rms(error):.2f}°",
        f"{error.mean():+.2f}°",
        f"{np.abs(error).max():.1f}°",
        f"{halves:.1f}°",
        f"{quarters:.1f}°",
        f"{L:.2f} ± {L * whole.std('L_d'):.2f} mH",
        f"{1e3 * np.exp(whole.value('psi_f')):.1f} mWb",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--drives", type=int, default=40)
    parser.add_argument(
        "--write", action="store_true", help="write docs/numbers/estimate_table.json"
    )
    drives = parser.parse_args().drives
    with Numbers("estimate_table", ["engine/*.[ch]", "tests/engine/*.py"]) as numbers:
        loops = []
        for name, conditions in LOOPS.items():
            loops.append(loop_row(name, squares(conditions, drives), drives))
            print("\t".join(loops[-1]), flush=True)
        numbers.table("loops", LOOP_HEADER, loops)
        numbers.value("drives", drives)
        paths = sorted(MEASURED.glob("data*.csv"))
        if not paths:
            print(f"skipped: no measured logs in {MEASURED}")
            return
        with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
            logs = list(pool.map(measured_row, paths))
        for row in logs:
            print("\t".join(row))
        numbers.table("measured", MEASURED_HEADER, logs)
        mean = np.mean([float(row[1].removesuffix("°")) for row in logs])
        numbers.value("mean", mean, "{:.2f}°")


if __name__ == "__main__":
    main()
