"""Largest errors of valid rows: random stops, restarts and loads, encoder in the loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from common import degrees_error, heading

from fluxobs import LeastSquaresObserver
from fluxobs.comparison.scenarios import believed_machine
from fluxobs.machines import example
from fluxobs.simulation.drive import (
    Course,
    Inverter,
    Profile,
    Trace,
    encoder_drive,
    rating,
    simulate_batch,
)
from fluxobs.simulation.drive.loop_observer import LoopObserver

LANES, DURATION = 16, 2.5


def select(row: Trace) -> tuple[object, ...]:
    return row.theta_e, row.reading.theta_e, row.reading.valid, row.reading.theta_e_std


def main() -> None:
    heading(
        f"Largest error of a valid row [degrees], number of the {LANES} lanes above 15 degrees, "
        "share of valid rows"
    )
    cases = (
        ("noise 0.3 %, offsets 1 %", 1.0, 0.0),
        ("and R + 20 %", 1.2, 0.0),
        ("and R - 20 %", 0.8, 0.0),
        ("and 0.5 % of rated EMF per phase", 1.0, 0.005),
    )
    for name in ("pmsm-2kw2", "servo-400w", "ipm-2kw2", "synrm-6kw7"):
        machine, rated = example(name), rating(name)
        I_n, rated_speed = machine.rated_current, rated.speed_e / machine.n_p
        flux = machine.flux_base(I_n)
        for case, factor, drop in cases:
            compiled = LeastSquaresObserver.for_machine(
                believed_machine(machine, {"R": factor}),
                sample_time=rated.sample_time,
                current_noise=0.003 * I_n,
            )
            observer = LoopObserver.of(compiled)
            drives, courses = [], []
            for lane in range(LANES):
                rng = np.random.default_rng(lane)
                drive = encoder_drive(
                    machine, rated, noise=0.003 * I_n, offset=rng.normal(0, 0.01 * I_n, 2)
                )
                inverter = Inverter(drop=drop * rated.speed_e * flux, smoothing=0.02 * I_n)
                drives.append(replace(drive, observer=observer, inverter=inverter))
                a, b = rng.uniform(0.2, 0.8), rng.choice([-1, 1]) * rng.uniform(0.2, 0.8)
                times = [0, 0.4, 0.8, rng.uniform(1.0, 1.3), 1.5, rng.uniform(1.7, 2.1), 2.5]
                speeds = np.array([0, a, a, 0, 0, b, b]) * rated_speed
                load = rng.uniform(-0.8, 0.8) * rated.torque
                torque = Profile([0.5, 0.5], [0.0, load])
                theta = rng.uniform(-3, 3)
                courses.append(Course(Profile(times, speeds), rated.dc_link, torque, theta_e=theta))
            theta, estimated, valid, _ = simulate_batch(
                drives, courses, DURATION, range(LANES), select
            )
            error = np.abs(degrees_error(estimated, theta, machine.half_turn_ambiguous))
            worst = np.where(valid, error, 0).max(axis=1)
            print(
                f"    {name:11s} {case:31s} {worst.max():5.1f}, {(worst > 15).sum():2d} lanes, "
                f"{valid.mean():.0%}",
                flush=True,
            )


if __name__ == "__main__":
    main()
