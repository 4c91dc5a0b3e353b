"""The likeliest cause of a constraint residual that is too large."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..logs.log import Aligned, Log
from ..logs.scales import Scales, excerpts
from ..machines import RotatingMachine
from ..model.inverter import SMOOTHING, inverter_direction
from .prepare import plain_observer

Array = NDArray[np.float64]

#: A suspect must reduce the residual to this share; by chance, the best of some twenty trials
#: reaches 0.85.
IMPROVEMENT = 0.75
#: Parameters are tried at these multiples of the machine file's values, the inverter's voltage at
#: these shares of the log's voltage: a guide to the cause, not a measurement.
FACTORS = (0.5, 0.75, 1.33, 2.0)
SHARES = (0.01, 0.02, 0.05, 0.1, 0.2)
#: Trials run with a long memory: a short one follows the error, and so hides it.
MEMORY, ROWS = 0.2, 20_000


@dataclass(frozen=True)
class Suspect:
    """A change that fits better than what was given."""

    name: str
    advice: str
    remaining: float  # share of the residual that is left with it


def lively(log: Log, rows: int = ROWS) -> Aligned:
    """The piece of the log with the largest voltage, cut to a bounded length."""

    def size(part: Aligned) -> float:
        return float(np.nanmean(np.abs(part.voltage))) if np.isfinite(part.voltage).any() else 0.0

    part = max(excerpts(log), key=size)
    middle = max(0, (len(part.t) - rows) // 2)
    cut = slice(middle, middle + rows)
    return Aligned(part.t[cut], part.current[cut], part.voltage[cut], None)


def _trials(
    machine: RotatingMachine, scales: Scales, u: Array, i: Array, lag: float
) -> Iterator[tuple[str, str, RotatingMachine, Array, Array]]:
    """Yield name, advice, and machine, voltage and current with one thing changed."""
    what = " and ".join(machine.inductance_names)
    for factor in FACTORS:
        changed = machine.scaled(["R_s"], factor)
        yield "R_s", f"R_s = {changed.R_s:.3g} Ω fits better than {machine.R_s:g} Ω", changed, u, i
        changed = machine.scaled(machine.inductance_names, factor)
        yield what, f"{what} × {factor:g} fits better than the machine file", changed, u, i
    direction = inverter_direction(i, SMOOTHING * scales.current)
    for share in SHARES:
        drop = share * scales.voltage
        yield (
            "the inverter",
            f"dead time and device drops of about {drop:.2g} V per phase fit better than none",
            machine,
            u - drop * direction,
            i,
        )
    gap = np.full((1, 2), np.nan)
    yield "the lag", f"--lag {lag + 1:g} fits better than {lag:g}", machine, np.r_[u[1:], gap], i
    yield "the lag", f"--lag {lag - 1:g} fits better than {lag:g}", machine, np.r_[gap, u[:-1]], i
    yield "the sign of the current", "the opposite sign fits better", machine, u, -i
    mirrored = i * np.array([1, -1])
    yield "the phase order", "exchanging two current phases fits better", machine, u, mirrored


def largest_suspect(
    log: Log, machine: RotatingMachine, scales: Scales, psi_f: float | None
) -> Suspect | None:
    """Try the usual errors on a piece of the log; return the one that explains most, if any does.

    `psi_f` is a scale for machines whose file does not give it.
    """
    part = lively(log)
    duration = len(part.t) * log.sample_time
    memory = max(min(MEMORY, duration / 4), 10 * log.sample_time)

    def residual(changed: RotatingMachine, voltage: Array, current: Array) -> float:
        observer = plain_observer(log, changed, scales, memory, psi_f)
        innovation = observer.run(voltage, current).innovation[len(current) // 3 :]
        return float(np.sqrt(np.mean(innovation**2))) * observer.constraint_noise

    base = residual(machine, part.voltage, part.current)
    if not (np.isfinite(base) and base > 0):
        return None
    suspects = [
        Suspect(name, advice, residual(changed, voltage, current) / base)
        for name, advice, changed, voltage, current in _trials(
            machine, scales, part.voltage, part.current, log.layout.lag
        )
    ]
    best = min(suspects, key=lambda suspect: suspect.remaining)
    return best if best.remaining < IMPROVEMENT else None
