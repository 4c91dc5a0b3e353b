"""An hour at 20 kHz in single precision under constant offsets: does the position error drift?

python benchmarks/long_run.py [--hours 1.0]
"""

from __future__ import annotations

import argparse

import numpy as np
from common import degrees_error, heading

from fluxobs import LeastSquaresObserver
from fluxobs.machines import SurfacePMSM, example
from fluxobs.simulation.closed_form.signals import vectors

RATE, BATCH = 20_000, 1_200_000  # a batch is a minute


def course(name: str, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return electrical angle [rad] and speed [rad/s] at these times."""
    if name == "constant speed":
        return 600.0 * t, np.full_like(t, 600.0)
    # The speed oscillates between 200 and 1000 rad/s with a period of eight seconds.
    w = 2 * np.pi / 8
    return 600.0 * t + 400.0 / w * np.sin(w * t), 600.0 + 400.0 * np.cos(w * t)


def minute(machine: SurfacePMSM, name: str, start: int, noise: float) -> tuple[np.ndarray, ...]:
    """Return (true angle, mean voltage of the interval that ends at the row, measured current)."""
    assert machine.psi_f is not None
    h = 1 / RATE
    k = np.arange(start - 1, start + BATCH)
    theta, speed = course(name, k * h)
    rotation = np.exp(1j * np.remainder(theta, 2 * np.pi))
    i = 4j * rotation
    flux = machine.L_s * i + machine.psi_f * rotation
    # Mean current over an interval by Euler-Maclaurin; the error h^4 is far below single precision.
    derivative = 1j * speed * i
    mean_current = (i[1:] + i[:-1]) / 2 - h * (derivative[1:] - derivative[:-1]) / 12
    u = np.diff(flux) / h + machine.R_s * mean_current + (0.12 - 0.08j)
    rng = np.random.default_rng(start)
    measured = i[1:] + (0.15 - 0.10j)
    if noise:
        measured = measured + noise * (rng.standard_normal(BATCH) + 1j * rng.standard_normal(BATCH))
    return theta[1:], vectors(u), vectors(measured)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--hours", type=float, default=1.0)
    minutes = round(parser.parse_args().hours * 60)
    machine = example("servo-400w")
    assert isinstance(machine, SurfacePMSM)
    heading(f"{minutes} minutes at 20 kHz in float32, offsets of 1 % (target: drift below 0.05°)")
    for name in ("constant speed", "oscillating speed"):
        for noise in (0.0, 0.02):
            observer = LeastSquaresObserver.for_machine(
                machine, sample_time=1 / RATE, precision="single"
            )
            state, means, worst, invalid = observer.init(), [], 0.0, 0
            for n in range(minutes):
                theta, u, i = minute(machine, name, n * BATCH, noise)
                state, estimate = observer.resume(state, u, i)
                settled = slice(RATE if n == 0 else 0, None)
                error = degrees_error(estimate.theta_e, theta)[settled]
                means.append(float(error.mean()))
                worst = max(worst, float(np.abs(error).max()))
                invalid += int((~estimate.valid[settled]).sum())
            drift = max(abs(mean - means[0]) for mean in means)
            print(
                f"    {name}, noise {noise:g} A: mean error of the first minute {means[0]:+.4f}°, "
                f"later within {drift:.5f}° of it; largest error {worst:.3f}°, {invalid} invalid "
                f"rows"
            )


if __name__ == "__main__":
    main()
