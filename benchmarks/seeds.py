"""Starts with known and unknown angle: rotation until valid, and the effect of a wrong angle."""

from __future__ import annotations

from typing import Any

import numpy as np
from common import heading

from fluxobs import AdaptiveObserver, LeastSquaresObserver
from fluxobs.machines import RotatingMachine, example
from fluxobs.simulation.closed_form.signals import driven, vectors

H, ROWS, TRIALS, PARTS = 1e-4, 4000, 12, 16
MACHINES = ("ipm-2kw2", "ipm-5kw6", "synrm-6kw7", "servo-400w", "induction-2kw2")
#: Electrical speed after a run-up of 0.13 s [rad/s]; load as a share of the rated current.
TOP, LOAD = 2 * np.pi * 60, 0.4
#: Name → (error of the given angle (None: drawn), stated standard deviation [rad]).
SEEDS: dict[str, tuple[float | None, float] | None] = {
    "unknown angle": None,
    "3 degrees": (None, 0.05),
    "Hall sensors": (None, 0.3),
    "90 degrees wrong, stated std 6": (np.pi / 2, 0.1),
}


def degrees(angle: Any) -> Any:
    return np.degrees(np.angle(np.exp(1j * np.asarray(angle))))


def trial(
    machine: RotatingMachine, observer: Any, seeding: tuple[float | None, float] | None, seed: int
):
    """Return (rotation until valid [°], largest valid error [°], number of sure and wrong rows)."""
    rng = np.random.default_rng(seed)
    rated_current = machine.rated_current or 1.0
    i_d = machine.magnetizing_current or (0.0 if machine.magnets else 0.5 * rated_current)
    rows = np.arange(ROWS * PARTS + 1) / PARTS
    speed = np.interp(rows, (0, 200, 1500), (0, 0, TOP))
    start = rng.uniform(-np.pi, np.pi)
    i_dq = np.full(rows.shape, i_d + 1j * LOAD * rated_current)
    signals = driven(machine, H, speed, i_dq, PARTS, start)
    i = vectors(signals.current) + 0.002 * rated_current * rng.standard_normal((ROWS + 1, 2))
    i += 0.01 * rated_current * np.array([1, -0.5])
    state = observer.init()
    if seeding is not None:
        seed_error = rng.standard_normal() * seeding[1] if seeding[0] is None else seeding[0]
        active_flux = 0.0 if machine.magnets else machine.saliency * i_d
        state = observer.seed(start + seed_error, i[0], theta_e_std=seeding[1], psi_f=active_flux)
    estimate = observer.resume(state, vectors(signals.voltage), i[1:])[1]
    error = degrees(estimate.theta_e - signals.theta_e[1:])
    if machine.half_turn_ambiguous:
        error = (error + 90) % 180 - 90
    std = np.degrees(estimate.theta_e_std)
    valid = estimate.valid
    rotation = np.cumsum(np.abs(degrees(np.diff(signals.theta_e))))
    first_valid = rotation[np.argmax(valid)] if valid.any() else np.inf
    sure_and_wrong = valid & (np.abs(error) > np.maximum(10, 5 * std))
    return first_valid, np.abs(error[valid]).max(initial=0.0), sure_and_wrong.sum()


def main() -> None:
    heading(
        f"Start at rest from {TRIALS} angles: rotation until valid (median, largest) and worst "
        "error"
    )
    print("    | machine | observer | start | valid after | worst | rows sure and wrong |")
    print("    |---|---|---|---|---|---|")
    for name in MACHINES:
        machine = example(name)
        assert isinstance(machine, RotatingMachine)
        for kind in (LeastSquaresObserver, AdaptiveObserver):
            options: dict[str, Any] = {"sample_time": H}
            observer: Any = kind.for_machine(machine, **options)
            for start, seeding in SEEDS.items():
                runs = [trial(machine, observer, seeding, seed) for seed in range(TRIALS)]
                first_valid, worst, wrong = (np.array(column) for column in zip(*runs, strict=True))
                print(
                    f"    | {name} | {'plain' if kind is LeastSquaresObserver else 'adaptive'} "
                    f"| {start} | {np.median(first_valid):.0f}°, {first_valid.max():.0f}° "
                    f"| {worst.max():.1f}° | {wrong.sum()} |"
                )


if __name__ == "__main__":
    main()
