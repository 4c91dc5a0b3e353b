"""Voltages held over a sample, with a short L/R and few samples per period.

Prints the table of docs/benchmarks.md, "Held voltages", for a motor of 50 mOhm and 20 uH at 10 kHz.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from fluxobs import LeastSquaresObserver
from fluxobs.machines import example

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from support.records import held, wrapped_degrees

H, MACHINE = 1e-4, example("drone-900kv")


def load(t):
    return np.where((t > 0.25) & (t < 0.4), 20.0, 8.0)


def main() -> None:
    print(
        "R h/L = 0.25, load steps, offsets: rms error [degrees] from 0.15 s on; floor = L sigma/psi"
    )
    for per_period in (10, 14, 28):
        speed = 2 * np.pi / (per_period * H)
        for label, options in (
            ("cubic only, 0.03 s", {"held": False, "memory": 0.03}),
            ("with kinks, 0.03 s", {"memory": 0.03}),
            ("with kinks, automatic", {"speed_e": speed}),
        ):
            clean = held(MACHINE, H, speed, load, 0.5, 0.1 + 0.05j, 0.02)
            observer = LeastSquaresObserver.for_machine(MACHINE, sample_time=H, **options)
            estimate = observer.run(clean.voltage, clean.current)
            error = wrapped_degrees(estimate.theta_e - clean.theta)[1500:]
            noise, noise_stds = 0.06, []
            for seed in range(4):
                noisy = held(MACHINE, H, speed, load, 0.5, 0.1 + 0.05j, 0.02, noise, seed)
                noisy_estimate = observer.run(noisy.voltage, noisy.current)
                noise_stds.append(
                    (wrapped_degrees(noisy_estimate.theta_e - noisy.theta)[1500:] - error).std()
                )
            floor = np.degrees(MACHINE.L_s * noise / MACHINE.psi_f)
            print(
                f"    {per_period:2d} samples per period, {label:25s} memory "
                f"{1e3 * observer.memory:4.1f} ms: {np.sqrt(np.mean(error**2)):.3f} rms without "
                f"noise; noise error {np.mean(noise_stds) / floor:.2f} of the floor"
            )


if __name__ == "__main__":
    main()
