"""Run time of the simulated drive: one second of a single drive, and a batch."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from common import heading

from fluxobs import AdaptiveObserver, LeastSquaresObserver
from fluxobs.machines import example
from fluxobs.simulation.drive import (
    Course,
    Drive,
    Profile,
    Trace,
    encoder_drive,
    rating,
    sensorless_drive,
    simulate,
    simulate_batch,
)
from fluxobs.simulation.drive.loop_observer import LoopObserver

MACHINE, RATED = example("pmsm-2kw2"), rating("pmsm-2kw2")
LANES, DURATION = 256, 1.0
REPETITIONS = 6
GENERATOR = np.random.default_rng(0)
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


def select_true(row: Trace) -> tuple[object, ...]:
    return row.theta_e, row.speed


def with_observer(kind: type[LeastSquaresObserver] | type[AdaptiveObserver]) -> list[Drive]:
    """Return drives with this observer in the loop; each drive has different offsets."""
    observer = LoopObserver.of(kind.for_machine(MACHINE, sample_time=RATED.sample_time))
    return [
        replace(
            sensorless_drive(MACHINE, RATED, noise=0.02, offset=GENERATOR.normal(0, 0.1, 2)),
            observer=observer,
        )
        for _ in range(LANES)
    ]


def best(run: object, times: int = 7) -> tuple[float, float]:
    """Return (shortest, median) time [s]; an earlier run compiles and is not timed."""
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

    heading(
        f"A batch of {LANES} different drives of one second (target 1 us per drive and sample); "
        "ratio to the loop with an encoder"
    )
    courses = [course(GENERATOR.uniform(0, 1), GENERATOR.uniform(-3, 3)) for _ in range(LANES)]
    batches = {
        "encoder": [encoder_drive(MACHINE, RATED, noise=0.02)] * LANES,
        "plain observer": with_observer(LeastSquaresObserver),
        "adaptive observer": with_observer(AdaptiveObserver),
    }
    times: dict[str, list[float]] = {name: [] for name in batches}
    for _ in range(REPETITIONS):  # interleaved: this computer's speed varies
        for name, drives in batches.items():
            fields = select_true if name == "encoder" else select
            started = time.perf_counter()
            simulate_batch(drives, courses, DURATION, range(LANES), fields)
            times[name].append(1e6 / LANES / ROWS * (time.perf_counter() - started))
    alone = float(np.median(times["encoder"][1:]))  # the first run compiles
    for name, microseconds in times.items():
        median, shortest = float(np.median(microseconds[1:])), min(microseconds[1:])
        print(
            f"    {name:20s} median {median:.2f} us, best {shortest:.2f} us, "
            f"ratio {median / alone:.2f}"
        )


if __name__ == "__main__":
    main()
