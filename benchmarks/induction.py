"""Sensorless drives of an induction machine with the plain observer in the loop.

Prints the table of docs/benchmarks.md, "Induction drives". All drives have offsets of 0.22 A (3 %
of rated) and noise of 0.02 A.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fluxobs.machines import example
from fluxobs.machines.model.frames import wrap
from fluxobs.simulation.drive import Course, Profile, rating, sensorless_drive, simulate
from fluxobs.simulation.drive.sensorless import RUNNING

MACHINE, RATED = example("induction-2kw2"), rating("induction-2kw2")
BASE = RATED.speed_e / MACHINE.n_p
#: Name → (speed over time, load over time, duration, options); speed and load as rated shares.
COURSES: dict[str, tuple[Any, Any, float, dict[str, float]]] = {
    "start, full load, loaded reversal": (
        [(0, 0), (0.2, 0.1), (0.6, 0.1), (1.0, 0.8), (1.8, 0.8), (2.8, -0.8), (3.6, -0.8)],
        [(1.3, 0), (1.3, 1)],
        3.6,
        {},
    ),
    "start under half load": (
        [(0, 0), (0.5, 0.2), (1.0, 0.5)],
        [(0.3, 0), (0.3, 0.5)],
        2.0,
        {},
    ),
    "150 %, half load on and off": (
        [(0, 0), (0.2, 0.1), (0.6, 0.1), (1.2, 1), (1.8, 1.5)],
        [(2.2, 0), (2.2, 0.5), (2.8, 0.5), (2.8, 0)],
        3.4,
        {},
    ),
    "2 %, half load on and off": (
        [(0, 0), (0.2, 0.1), (1.0, 0.1), (1.5, 0.02)],
        [(3.0, 0), (3.02, 0.5), (4.5, 0.5), (4.52, 0)],
        6.0,
        {"memory": 0.2, "speed_bandwidth": 50.0},
    ),
}
ERRORS = ({}, {"R_R": 1.2}, {"R_R": 0.8}, {"R_s": 1.2}, {"R_s": 0.8})


def main() -> None:
    for name, (speed, load, duration, options) in COURSES.items():
        print(name)
        course = Course(
            Profile([t for t, _ in speed], [x * BASE for _, x in speed]),
            RATED.dc_link,
            Profile([t for t, _ in load], [x * RATED.torque for _, x in load]),
        )
        for factors in ERRORS:
            believed = MACHINE
            for key, factor in factors.items():
                believed = believed.scaled([key], factor)
            drive = sensorless_drive(
                MACHINE, RATED, believed=believed, offset=(0.13, 0.18), noise=0.02, **options
            )
            run = simulate(drive, course, duration)
            trace, settled = run.trace, run.t > 1.0
            error = np.degrees(wrap(np.asarray(trace.reading.theta_e - trace.theta_e)))[settled]
            valid = np.asarray(trace.reading.valid)[settled]
            running = np.asarray(trace.mode == RUNNING)[settled]
            speed_error = np.abs(trace.speed - trace.reference)[settled] / BASE
            label = ", ".join(f"{key} x {factor}" for key, factor in factors.items()) or "correct"
            print(
                f"    {label:12s} in the loop {running.mean():5.1%}, position error "
                f"{np.sqrt(np.mean(error[running] ** 2)):6.2f} deg rms, "
                f"{np.abs(error[valid]).max(initial=0):6.2f} at most on valid rows, speed error "
                f"{speed_error.max():6.1%} at most, {speed_error[-1]:5.2%} of rated at the end"
            )


if __name__ == "__main__":
    main()
