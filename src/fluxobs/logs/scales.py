"""Sizes of a log's signals, measured in a first pass; the machine file does not give them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import RecordError
from ..machines.model.frames import wrap
from .log import Log
from .quality.detect import Detector
from .quality.noise import white_noise
from .time.aligned import Aligned, between, joined

#: Number of excerpts examined, evenly spread over a log, and rows of each excerpt.
EXCERPTS, EXCERPT_ROWS = 64, 16384


@dataclass(frozen=True)
class Scales:
    """Sizes of the signals; each size may be wrong by a factor of two or three.

    Attributes
    ----------
    current : float
        95th percentile of |i| [A].
    voltage : float
        95th percentile of |u| [V].
    current_noise, voltage_noise : float
        Standard deviation of one component, from third differences [A], [V]. For a commanded
        voltage, this value is the activity of the controller, not an error.
    current_speed : float
        95th percentile of the speed at which the current vector turns [rad/s]; if the current is
        small, this value is only noise.
    """

    current: float
    voltage: float
    current_noise: float
    voltage_noise: float
    current_speed: float


def excerpts(log: Log) -> Iterator[Aligned]:
    """Yield evenly spread excerpts of a log, equal for every format; of a short log, all rows."""
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
    for batch in log.aligned():
        for start in starts:
            lower, upper = max(start - row, 0), min(start + EXCERPT_ROWS - row, len(batch.t))
            if lower < upper:
                pieces.append(between(batch, lower, upper))
                if row + upper == start + EXCERPT_ROWS:
                    yield joined(pieces)
                    pieces = []
        row += len(batch.t)


#: Largest current or voltage: raw values of a counter with 32 bits are smaller, and its fourth
#: power is a number.
MOST = 1e12


def measure_scales(log: Log) -> Scales:
    """Return the scales of a log.

    Raises
    ------
    RecordError
        The log has no finite current or voltage, or the current or voltage is always zero, or
        larger than any drive's.
    """
    return scales_of(excerpts(log), log.sample_time, log.path)


def scales_of(pieces: Iterable[Aligned], sample_time: float, path: Path) -> Scales:
    """Return the scales from parts of a log; raise errors like :func:`measure_scales`."""
    pieces = list(pieces)
    currents, voltages, voltage_noise, turning = [], [], [], []
    for piece in pieces:
        turning.append(np.abs(wrap(np.diff(np.arctan2(piece.current[:, 1], piece.current[:, 0])))))
        currents.append(np.hypot(*piece.current.T))
        voltages.append(np.hypot(*piece.voltage.T))
        voltage_noise.append(white_noise(piece.voltage))
    angles = np.concatenate(turning)
    angles = angles[np.isfinite(angles)]
    i, u = np.concatenate(currents), np.concatenate(voltages)
    i, u = i[np.isfinite(i)], u[np.isfinite(u)]
    sizes = []
    for quantity, unit, values in (("current", "A", i), ("voltage", "V", u)):
        if len(values) == 0:
            raise RecordError(f"{path}: no row has a {quantity}; are the columns right?")
        if not values.any():
            raise RecordError(
                f"{path}: the {quantity} is zero in every row; are column and scale right?"
            )
        size = float(np.percentile(values, 95))
        if size > MOST:
            raise RecordError(
                f"{path}: the {quantity} is {size:.3g} {unit}: more than any drive or "
                f"counter has; are column and scale right?"
            )
        sizes.append(size)
    current, voltage = sizes[0] or float(i.max()), sizes[1]
    # Faulty rows and commutations would count as noise.
    detector = Detector(current, voltage, 0.0)
    noise = [white_noise(detector.smooth(piece)) for piece in pieces]
    return Scales(
        current,
        voltage,
        float(np.median(noise)),
        float(np.median(voltage_noise)),
        float(np.percentile(angles, 95)) / sample_time if len(angles) else 0.0,
    )
