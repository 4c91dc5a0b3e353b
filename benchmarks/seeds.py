"""A start from a known angle beside one from nothing: rotation until the position is valid, and
what a wrong angle does."""

from __future__ import annotations

from typing import Any

import numpy as np
from common import heading

from fluxobs import AdaptiveObserver, LeastSquaresObserver
from fluxobs.machines import RotatingMachine, example
from fluxobs.simulation.closed_form.signals import driven, vectors

H, ROWS, TRIALS, PARTS = 1e-4, 4000, 12, 16
MACHINES = ("ipm-2kw2", "ipm-5kw6", "synrm-6kw7", "servo-400w", "induction-2kw2")
#: Electrical speed that a run-up of 0.13 s reaches [rad/s]; load [of rated current].
TOP, LOAD = 2 * np.pi * 60, 0.4
#: Name → error of the angle and its standard deviation as given [rad]; None: drawn with it.
SEEDS: dict[str, tuple[float | None, float] | None] = {
    "from nothing": None,
    "3 degrees": (None, 0.05),
    "Hall sensors": (None, 0.3),
    "90 degrees wrong, said to be 6": (np.pi / 2, 0.1),
}


def degrees(angle: Any) -> Any:
    return np.degrees(np.angle(np.exp(1j * np.asarray(angle))))


def trial(
    machine: RotatingMachine, observer: Any, how: tuple[float | None, float] | None, seed: int
):
    """Rotation at the first valid row, largest error of valid ones [°]; rows sure and wrong."""
    rng = np.random.default_rng(seed)
    rated = machine.rated_current or 1.0
    along = machine.magnetizing_current or (0.0 if machine.magnets else 0.5 * rated)
    rows = np.arange(ROWS * PARTS + 1) / PARTS
    speed = np.interp(rows, (0, 200, 1500), (0, 0, TOP))
    start = rng.uniform(-np.pi, np.pi)
    i_dq = np.full(rows.shape, along + 1j * LOAD * rated)
    true = driven(machine, H, speed, i_dq, PARTS, start)
    i = vectors(true.current) + 0.002 * rated * rng.standard_normal((ROWS + 1, 2))
    i += 0.01 * rated * np.array([1, -0.5])
    state = observer.init()
    if how is not None:
        error = rng.standard_normal() * how[1] if how[0] is None else how[0]
        active = 0.0 if machine.magnets else machine.saliency * along
        state = observer.seed(start + error, i[0], theta_e_std=how[1], psi_f=active)
    found = observer.resume(state, vectors(true.voltage), i[1:])[1]
    off = degrees(found.theta_e - true.theta_e[1:])
    if machine.half_turn_ambiguous:
        off = (off + 90) % 180 - 90
    std = np.degrees(found.theta_e_std)
    valid = found.valid
    turned = np.cumsum(np.abs(degrees(np.diff(true.theta_e))))
    first = turned[np.argmax(valid)] if valid.any() else np.inf
    sure_and_wrong = valid & (np.abs(off) > np.maximum(10, 5 * std))
    return first, np.abs(off[valid]).max(initial=0.0), sure_and_wrong.sum()


def main() -> None:
    heading(f"Start at rest, {TRIALS} angles: rotation until valid (median, most) and worst error")
    print("    | machine | observer | start | valid after | worst | rows sure and wrong |")
    print("    |---|---|---|---|---|---|")
    for name in MACHINES:
        machine = example(name)
        assert isinstance(machine, RotatingMachine)
        for kind in (LeastSquaresObserver, AdaptiveObserver):
            given: dict[str, Any] = {"sample_time": H}
            observer: Any = kind.for_machine(machine, **given)
            for start, how in SEEDS.items():
                runs = [trial(machine, observer, how, seed) for seed in range(TRIALS)]
                first, worst, wrong = (np.array(column) for column in zip(*runs, strict=True))
                print(
                    f"    | {name} | {'plain' if kind is LeastSquaresObserver else 'adaptive'} "
                    f"| {start} | {np.median(first):.0f}°, {first.max():.0f}° "
                    f"| {worst.max():.1f}° | {wrong.sum()} |"
                )


if __name__ == "__main__":
    main()
