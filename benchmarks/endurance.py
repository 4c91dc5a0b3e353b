"""A hundred million samples in single precision: drifting offsets, stops, bad samples, restarts.

A servo runs 83 minutes at 20 kHz. Every twenty seconds the servo runs up, reverses and stops for
two seconds. The offsets change randomly by a tenth per minute. Each minute has missing and
implausible samples, and a gap after which the observer restarts. The benchmark shows whether errors
grow and whether all outputs are finite.

    python benchmarks/endurance.py [--samples 1e8]
"""

from __future__ import annotations

import argparse

import numpy as np
from common import degrees_error, heading

from fluxobs import AdaptiveObserver, LeastSquaresObserver
from fluxobs.machines import example
from fluxobs.observers import Priors
from fluxobs.simulation.closed_form.signals import vectors

RATE, BATCH = 20_000, 1_200_000  # a batch is a minute
MACHINE = example("servo-400w")
#: Periodic speed [rad/s] over time [s].
TIMES = np.array([0.0, 1.0, 8.0, 9.0, 11.0, 13.0, 17.0, 18.0, 20.0])
SPEEDS = np.array([0.0, 600.0, 900.0, 0.0, 0.0, -700.0, -400.0, 0.0, 0.0])
#: Angle at these times [rad].
ANGLES = np.concatenate([[0.0], np.cumsum(np.diff(TIMES) * (SPEEDS[1:] + SPEEDS[:-1]) / 2)])


def course(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return electrical angle [rad] and speed [rad/s]."""
    cycles, cycle_time = np.divmod(t, TIMES[-1])
    segment = np.minimum(np.searchsorted(TIMES, cycle_time, "right") - 1, len(TIMES) - 2)
    elapsed = cycle_time - TIMES[segment]
    acceleration = (SPEEDS[segment + 1] - SPEEDS[segment]) / (TIMES[segment + 1] - TIMES[segment])
    speed = SPEEDS[segment] + acceleration * elapsed
    angle = ANGLES[segment] + elapsed * (SPEEDS[segment] + acceleration * elapsed / 2)
    return np.remainder(cycles * ANGLES[-1], 2 * np.pi) + angle, speed


def minute(n: int, offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (true angle, voltages, currents); `offsets` gives the offsets at start and end."""
    h = 1 / RATE
    theta, speed = course((np.arange(-1, BATCH) + n * BATCH) * h)
    rotation = np.exp(1j * theta)
    current = 4j * rotation
    flux = MACHINE.L_s * current + MACHINE.psi_f * rotation
    derivative = 1j * speed * current
    mean_current = (current[1:] + current[:-1]) / 2 - h * (derivative[1:] - derivative[:-1]) / 12
    share = np.linspace(0, 1, BATCH)[:, None]
    voltage_offset, current_offset = ((1 - share) * offsets[0] + share * offsets[1]).T
    rng = np.random.default_rng([3, n])
    noise = 0.02 * (rng.standard_normal(BATCH) + 1j * rng.standard_normal(BATCH))
    u = vectors(np.diff(flux) / h + MACHINE.R_s * mean_current + voltage_offset)
    i = vectors(current[1:] + current_offset + noise)
    u[rng.integers(0, BATCH, 100)] = np.nan
    i[rng.integers(0, BATCH, 100)] = np.nan
    u[rng.integers(0, BATCH, 3)] = 1e30
    i[rng.integers(0, BATCH, 3), 1] = -1e9
    missing = rng.integers(0, BATCH - 10)
    i[missing : missing + 6] = np.inf  # too long to bridge
    return theta[1:], u, i


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--samples", type=float, default=1e8)
    minutes = int(np.ceil(parser.parse_args().samples / BATCH))
    heading(f"{minutes * BATCH / 1e6:.0f} million samples in float32, {minutes} minutes at 20 kHz")
    priors = Priors(resistance=0.01, inverter=0.02)
    observers = {
        "plain": LeastSquaresObserver.for_machine(
            MACHINE, sample_time=1 / RATE, precision="single"
        ),
        "adaptive": AdaptiveObserver.for_machine(
            MACHINE,
            sample_time=1 / RATE,
            unknowns=("drift", "resistance", "inverter"),
            precision="single",
            priors=priors,
        ),
    }
    states = {name: observer.init() for name, observer in observers.items()}
    rms = {name: [] for name in observers}
    beyond = dict.fromkeys(observers, 0)
    worst = dict.fromkeys(observers, 0.0)
    valid = dict.fromkeys(observers, 0)
    infinite = dict.fromkeys(observers, 0)
    rng = np.random.default_rng(1)
    initial_offsets = np.array([0.12, 0.15]) * np.exp(2j * np.pi * rng.random(2))  # [V], [A]: 1 %
    offsets = initial_offsets
    for n in range(minutes):
        walk = (
            0.1 * np.abs(initial_offsets) * (rng.standard_normal(2) + 1j * rng.standard_normal(2))
        )
        next_offsets = 0.98 * offsets + walk
        theta, u, i = minute(n, np.array([offsets, next_offsets]))
        offsets = next_offsets
        for name, observer in observers.items():
            states[name], estimate = observer.resume(states[name], u, i)
            valid_rows = estimate.valid
            error = degrees_error(estimate.theta_e, theta)[valid_rows]
            std = np.degrees(estimate.theta_e_std[valid_rows])
            rms[name].append(np.sqrt(np.mean(error**2)))
            beyond[name] += int((np.abs(error) > 3 * std + 1e-9).sum())
            worst[name] = max(worst[name], float(np.abs(error).max()))
            valid[name] += int(valid_rows.sum())
            columns = (
                estimate.flux,
                estimate.psi_f,
                estimate.theta_e,
                estimate.speed_e,
                estimate.drift,
            )
            columns += (estimate.theta_e_std, estimate.theta_e_tracked)
            infinite[name] += sum(int((~np.isfinite(column)).sum()) for column in columns)
    for name, observer in observers.items():
        tenth = max(1, minutes // 10)
        first_rms, last_rms = (
            np.sqrt(np.mean(np.square(rms[name][part])))
            for part in (slice(0, tenth), slice(-tenth, None))
        )
        counts = observer.counts(states[name])
        print(
            f"    {name}: rms error {first_rms:.3f}° in the first tenth, {last_rms:.3f}° in the "
            f"last tenth; valid {valid[name] / (minutes * BATCH):.1%}, worst valid row "
            f"{worst[name]:.1f}°, {beyond[name] / valid[name]:.2%} beyond 3 σ; {counts.restarts} "
            f"restarts; {infinite[name]} outputs are not finite"
        )


if __name__ == "__main__":
    main()
