"""Starts from rest under full load, with injection and a switching inverter; polarity.

python benchmarks/from_rest.py [--drives 30] [--starts 1000]

R is assumed 20 % too large, dead time 1.5 % of the period, offsets 1 %, noise 0.2 %, 12 bits. The
torque builds up against a brake, which opens; zero speed for two seconds under full load, then 1 %
of the rated speed and a reversal (tests/firmware/at_rest.c).
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from common import heading

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from fluxobs.machines import InteriorPMSM, SynchronousReluctance, example
from support.at_rest import interior
from support.from_rest import build, drive, run

#: Title → machine, assumed multiples of L_d and L_q, other parameters of the drive.
CASES = {
    "L_q/L_d 1.5": (interior(1.5), 1.0, 1.0, {}),
    "L_d, L_q +20 %": (interior(1.5), 1.2, 1.2, {}),
    "L_d, L_q -20 %": (interior(1.5), 0.8, 0.8, {}),
    "L_d -20 %, L_q +20 %": (interior(1.5), 0.8, 1.2, {}),
    "L_q/L_d 1.2": (interior(1.2), 1.0, 1.0, {}),
    "L_q/L_d 2.5": (interior(2.5), 1.0, 1.0, {}),
    "no load": (interior(1.5), 1.0, 1.0, {"load": 1.0}),
    "zero speed for a minute": (interior(1.5), 1.0, 1.0, {"hold": 60.0, "duration": 61.0}),
    "reluctance": (example("synrm-6kw7"), 1.0, 1.0, {"saturation": 0.0, "J": 0.05}),
}


def line(title: str, drives: list[dict[str, float]]) -> str:
    """Return a row of the table."""

    def all_of(name: str) -> np.ndarray:
        return np.array([one[name] for one in drives if name in one])

    once = all_of("starts") == 1
    rms = np.sqrt(np.mean(all_of("rms")[once] ** 2))
    return (
        f"    {title:26s}{once.sum():4d} of {len(drives):3d}{all_of('torque_at')[once].max():8.2f}"
        f"{all_of('back')[once].min():8.0f}{np.median(all_of('valid')[once]):8.1%}{rms:8.2f}"
        f"{all_of('worst')[once].max():7.1f}{np.median(all_of('std')[once]):7.2f}"
        f"{np.mean(all_of('within')[once]):8.1%}"
    )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--drives", type=int, default=30)
    parser.add_argument("--starts", type=int, default=1000, help="for the polarity")
    options = parser.parse_args()
    heading("Start from rest under full load, and ± 1 % of the rated speed")
    print(
        "    drives that start once and are never lost; of these: time to torque [s], largest\n"
        "    rotation backwards [deg], rows valid, rms and largest error, sigma [deg], 2 sigma"
    )
    with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(os.cpu_count()) as pool:

        def drives(
            machine: InteriorPMSM | SynchronousReluctance,
            L_d: float,
            L_q: float,
            n: int,
            **more: float,
        ) -> list[dict[str, float]]:
            folder = Path(tempfile.mkdtemp(dir=scratch))
            program = build(machine, folder, L_d, L_q)
            values = [drive(machine, seed, L_d, L_q, **more) for seed in range(1000, 1000 + n)]
            return list(pool.map(lambda given: run(program, given), values))

        for title, (machine, L_d, L_q, more) in CASES.items():
            print(line(title, drives(machine, L_d, L_q, options.drives, **more)), flush=True)
        for saturation in (0.1, 0.0):
            starts = drives(
                interior(1.5),
                1.0,
                1.0,
                options.starts,
                saturation=saturation,
                hold=1.0,
                duration=0.14,
            )
            begun = [one for one in starts if one["starts"] > 0]
            print(
                f"    polarity, saturation {saturation:.0%}: "
                f"{sum(one['open'] == 0 and abs(one['seed_error']) < 90 for one in begun)} right, "
                f"{sum(one['open'] == 0 and abs(one['seed_error']) > 90 for one in begun)} wrong, "
                f"{sum(one['open'] > 0 for one in begun)} open of {len(starts)}"
            )


if __name__ == "__main__":
    main()
