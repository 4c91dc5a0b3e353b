"""First pass over a log: the sizes of its signals, which the machine file does not give."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.arrays import Array
from ..errors import RecordError
from ..machines.model.frames import wrap
from .aligned import Aligned, between, joined
from .log import Log

#: At most this much of a log is examined, evenly spread.
EXCERPTS, EXCERPT_ROWS = 64, 16384
#: Rows from which one noise level is taken; transients do not move the median of these levels.
NOISE_ROWS = 256


@dataclass(frozen=True)
class Scales:
    """Sizes of the signals; each needs to be right only to within a factor of a few.

    Attributes
    ----------
    current : float
        95th percentile of |i| [A].
    voltage : float
        95th percentile of |u| [V].
    current_noise, voltage_noise : float
        Standard deviation of one component, from third differences [A], [V]. For a commanded
        voltage it shows what the controller does, not an error.
    current_speed : float
        95th percentile of the speed at which the current vector turns [rad/s]; nothing but noise if
        there is little current.
    """

    current: float
    voltage: float
    current_noise: float
    voltage_noise: float
    current_speed: float


def excerpts(log: Log) -> Iterator[Aligned]:
    """Yield evenly spread pieces of a log, independent of its format; all of it if it is short."""
    if len(log) <= EXCERPTS * EXCERPT_ROWS:
        yield joined(list(log.aligned()))
        return
    spacing = len(log) // EXCERPTS
    starts = [log.first + n * spacing for n in range(EXCERPTS)]
    if log.table.random_access:
        for start in starts:
            yield joined(list(log.aligned(start, start + EXCERPT_ROWS)))
        return
    row, pieces = log.first, []
    for part in log.aligned():
        for start in starts:
            low, high = max(start - row, 0), min(start + EXCERPT_ROWS - row, len(part.t))
            if low < high:
                pieces.append(between(part, low, high))
                if row + high == start + EXCERPT_ROWS:
                    yield joined(pieces)
                    pieces = []
        row += len(part.t)


def white_noise(signal: Array) -> float:
    """Std of one component of white noise on a smooth signal, (rows, 2).

    Third differences remove anything smooth and have 20 times the noise's variance.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # garbage must not stop it
        third = np.diff(signal, 3, axis=0)
    rows = max(1, min(NOISE_ROWS, len(third)))
    blocks = third[: len(third) // rows * rows].reshape(-1, rows, 2)
    with np.errstate(over="ignore", invalid="ignore"):
        level = np.mean(blocks**2, axis=(1, 2))
    level = level[np.isfinite(level)]
    return float(np.sqrt(np.median(level) / 20)) if len(level) else 0.0


def measure_scales(log: Log) -> Scales:
    """Measure the scales of a log.

    Raises
    ------
    RecordError
        It has no finite current or voltage, or one of them is zero throughout.
    """
    return scales_of(excerpts(log), log.sample_time, log.path)


def scales_of(parts: Iterable[Aligned], sample_time: float, path: Path) -> Scales:
    """The same, of some pieces of a log."""
    currents, voltages, noise, voltage_noise, turning = [], [], [], [], []
    for part in parts:
        turning.append(np.abs(wrap(np.diff(np.arctan2(part.current[:, 1], part.current[:, 0])))))
        currents.append(np.hypot(*part.current.T))
        voltages.append(np.hypot(*part.voltage.T))
        noise.append(white_noise(part.current))
        voltage_noise.append(white_noise(part.voltage))
    turned = np.concatenate(turning)
    turned = turned[np.isfinite(turned)]
    i, u = np.concatenate(currents), np.concatenate(voltages)
    i, u = i[np.isfinite(i)], u[np.isfinite(u)]
    for what, values in (("current", i), ("voltage", u)):
        if len(values) == 0:
            raise RecordError(f"{path}: no row has a {what}; are the columns right?")
        if not values.any():
            raise RecordError(
                f"{path}: the {what} is zero in every row: nothing can be learnt "
                f"from it; are column and scale right?"
            )
    return Scales(
        float(np.percentile(i, 95)) or float(i.max()),
        float(np.percentile(u, 95)),
        float(np.median(noise)),
        float(np.median(voltage_noise)),
        float(np.percentile(turned, 95)) / sample_time if len(turned) else 0.0,
    )
