"""Stops under load: a servo runs 17 minutes at 20 kHz with random speed, load and stops.

Stops are the hardest case for a sensorless observer: at standstill the flux does not depend on the
rotor, and the voltage is only the resistive drop. A quarter of the segments is stopped. An event is
a sequence of valid rows with errors above ten degrees.

    python benchmarks/stops.py [--minutes 17]
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from common import degrees_error, heading
from random_drives import DURATION, course

from fluxobs import AdaptiveObserver, LeastSquaresObserver
from fluxobs.machines import example
from fluxobs.simulation.closed_form.signals import between_rows, driven, vectors

H, RATED, PARTS = 5e-5, 1257.0, 4
MACHINE = example("servo-400w")
RUNS = [
    (kind, factor, precision)
    for kind, factor in (("plain", 1.0), ("adaptive", 1.0), ("adaptive", 1.2))
    for precision in ("double", "single")
]


def attempt(seed: int) -> list[tuple[int, int, float]]:
    """Return (number of valid rows, number of events, worst valid error) for each of RUNS."""
    rng = np.random.default_rng([17, seed])
    speed, load = course(rng, H, 0.25)
    current = MACHINE.rated_current
    signals = driven(
        MACHINE,
        H,
        between_rows(RATED * speed, PARTS),
        between_rows(0.7j * load * current, PARTS),
        PARTS,
        rng.uniform(-np.pi, np.pi),
    )
    noise = 0.005 * current
    u = vectors(np.concatenate([[np.nan], signals.voltage]))
    i = signals.current + 0.01 * current * np.exp(2j * np.pi * rng.random())
    i = vectors(i + noise * (rng.standard_normal(len(i)) + 1j * rng.standard_normal(len(i))))
    results = []
    for kind, factor, precision in RUNS:
        kind_of_observer = LeastSquaresObserver if kind == "plain" else AdaptiveObserver
        observer = kind_of_observer.for_machine(
            MACHINE.with_values(R_s=factor * MACHINE.R_s),
            sample_time=H,
            current_noise=noise,
            precision=precision,
        )
        estimate = observer.run(u, i)
        error = np.abs(degrees_error(estimate.theta_e, signals.theta_e))
        wrong = estimate.valid & (error > 10)
        events = int(np.sum(np.diff(wrong.astype(int)) == 1) + wrong[0])
        results.append(
            (int(estimate.valid.sum()), events, float(error[estimate.valid].max(initial=0)))
        )
    return results


def main(minutes: float) -> None:
    drives = round(60 * minutes / DURATION)
    heading(
        f"Stops under load, {drives * DURATION / 60:.0f} minutes at 20 kHz: share of valid rows, "
        "events with errors above ten degrees, worst valid row (target: 0 events)"
    )
    with ProcessPoolExecutor() as pool:
        results = np.array(list(pool.map(attempt, range(drives))))
    rows = drives * DURATION / H
    for k, (kind, factor, precision) in enumerate(RUNS):
        valid, events, worst = results[:, k].T
        print(
            f"    {kind:8s} R x {factor:.1f} {precision}: valid {valid.sum() / rows:.0%}, "
            f"{events.sum():.0f} events, worst {worst.max():.1f} degrees"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=17)
    main(parser.parse_args().minutes)
