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
    full = RATED.speed_e / MACHINE.n_p
    return Course(
        Profile([0.0, 0.2, 0.7], [0.0, 0.0, 0.5 * full]),
        RATED.dc_link,
        Profile([0.8, 0.8], [0.0, load * RATED.torque]),
        theta_e=theta_e,
    )


def keep(row: Trace) -> tuple[object, ...]:
    return row.theta_e, row.speed, row.reading.theta_e, row.reading.theta_e_std


def best(run: object, times: int = 7) -> tuple[float, float]:
    """Shortest and median time [s]; a first run compiles."""
    run()
    taken = []
    for _ in range(times):
        started = time.perf_counter()
        run()
        taken.append(time.perf_counter() - started)
    return min(taken), float(np.median(taken))


def main() -> None:
    heading("One second of the drive at 8 kHz, compiled, averaged inverter (target 0.15 s)")
    for name, drive in (
        ("sensorless: FOC, observer in the loop", sensorless_drive(MACHINE, RATED, noise=0.02)),
        ("encoder: FOC alone", encoder_drive(MACHINE, RATED, noise=0.02)),
    ):
        least, median = best(lambda drive=drive: simulate(drive, course(), DURATION))
        print(f"    {name:38s} median {median:.3f} s, best {least:.3f} s")

    heading(f"A batch of {LANES} such seconds, all different (target 1 us per drive and sample)")
    rng = np.random.default_rng(0)
    drives = [
        sensorless_drive(MACHINE, RATED, noise=0.02, offset=rng.normal(0, 0.1, 2))
        for _ in range(LANES)
    ]
    courses = [course(rng.uniform(0, 1), rng.uniform(-3, 3)) for _ in range(LANES)]
    least, median = best(
        lambda: simulate_batch(drives, courses, DURATION, range(LANES), keep), times=5
    )
    each = 1e6 / LANES / ROWS
    print(f"    median {each * median:.2f} us, best {each * least:.2f} us ({median:.2f} s in all)")


if __name__ == "__main__":
    main()
