"""Run time of the simulated drive: one second of a single drive, and a batch."""

from __future__ import annotations

import time

import numpy as np
from common import heading

from fluxobs.machines import example
from fluxobs.simulation.drive import (
    Course,
    Profile,
    Trace,
    encoder_drive,
    rating,
    sensorless_drive,
    simulate,
    simulate_batch,
)

MACHINE, RATED = example("pmsm-2kw2"), rating("pmsm-2kw2")
LANES, DURATION = 256, 1.0
ROWS = round(DURATION / RATED.sample_time)


def course(load: float = 0.5, theta_e: float = 1.0) -> Course:
    rated_speed = RATED.speed_e / MACHINE.n_p
    return Course(
        Profile([0.0, 0.2, 0.7], [0.0, 0.0, 0.5 * rated_speed]),
        RATED.dc_link,
        Profile([0.8, 0.8], [0.0, load * RATED.torque]),
        theta_e=theta_e,
    )


def select(row: Trace) -> tuple[object, ...]:
    return row.theta_e, row.speed, row.reading.theta_e, row.reading.theta_e_std


def best(run: object, times: int = 7) -> tuple[float, float]:
    """Return shortest and median time [s]; a first run compiles."""
    run()
    durations = []
    for _ in range(times):
        started = time.perf_counter()
        run()
        durations.append(time.perf_counter() - started)
    return min(durations), float(np.median(durations))


def main() -> None:
    heading("One second of the drive at 8 kHz, compiled, averaged inverter (target 0.15 s)")
    for name, drive in (
        ("sensorless: FOC, observer in the loop", sensorless_drive(MACHINE, RATED, noise=0.02)),
        ("encoder: FOC alone", encoder_drive(MACHINE, RATED, noise=0.02)),
    ):
        shortest, median = best(lambda drive=drive: simulate(drive, course(), DURATION))
        print(f"    {name:38s} median {median:.3f} s, best {shortest:.3f} s")

    heading(f"A batch of {LANES} such seconds, all different (target 1 us per drive and sample)")
    rng = np.random.default_rng(0)
    drives = [
        sensorless_drive(MACHINE, RATED, noise=0.02, offset=rng.normal(0, 0.1, 2))
        for _ in range(LANES)
    ]
    courses = [course(rng.uniform(0, 1), rng.uniform(-3, 3)) for _ in range(LANES)]
    shortest, median = best(
        lambda: simulate_batch(drives, courses, DURATION, range(LANES), select), times=5
    )
    microseconds = 1e6 / LANES / ROWS
    print(
        f"    median {microseconds * median:.2f} us, best {microseconds * shortest:.2f} us "
        f"({median:.2f} s in all)"
    )


if __name__ == "__main__":
    main()
