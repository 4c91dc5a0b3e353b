"""Contiguous segments of a log, integrated for the fit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array
from ..errors import FluxobsError
from ..logs.log import Log
from ..logs.scales import Scales, excerpts
from ..machines import RotatingMachine
from ..machines.model.held import mean_current, without_kinks
from ..machines.model.inverter import SMOOTHING, inverter_direction
from ..observers import LeastSquaresObserver
from ..observers.adaptive import OFFSET_SHARE
from ..observers.for_log import plain_for

#: A segment lasts this many turns, but at least this many rows. The drift within a segment is
#: assumed constant.
TURNS, SHORTEST = 2.5, 100
#: Two harder knees of the inverter's sign, as shares of the usual knee. All three knees together
#: approximate any usual curve well enough for a right R_s and V_d
#: (tests/identification/test_identify.py); with only the last knee, V_d of the demo log was 7 % too
#: large.
HARDER = (0.45, 0.2)


@dataclass(frozen=True, eq=False)
class Segment:
    """Segment without a gap; its integrals start at the first row.

    Attributes
    ----------
    t : (rows,) array
        Time since the first row [s].
    current : (rows, 2) array
        [A].
    voltage : (rows, 2) array
        ∫ u dt [Vs].
    charge : (rows, 2) array
        ∫ i dt [As].
    inverter : (rows, 2) array
        ∫ of the inverter's direction [s]; V_d times this integral is the loss.
    harder : (2, rows, 2) array
        Change of `inverter` with harder knees [s].
    offset : (2, rows, 2) array
        Change of `inverter` per ampere of current offset in α, and in β [s/A].
    curve : (rows, 2) array
        Change of `inverter` if the loss continues to grow with the current [s].
    start : (2,) array
        Flux at the first row, from the observer [Wb].
    drift : (2,) array
        Drift, from the observer [V].
    lengths : (2,) array
        Smallest and largest length of the position vector, from the observer [Wb].
    """

    t: Array
    current: Array
    voltage: Array
    charge: Array
    inverter: Array
    harder: Array
    offset: Array
    curve: Array
    start: Array
    drift: Array
    lengths: Array

    def __len__(self) -> int:
        return len(self.t)


def typical_length(data: Sequence[Segment], inductance: float) -> float:
    """Return the median length of λ - L i over the segments, from the observer [Wb]."""
    lengths = [np.linalg.norm(segment.start - inductance * segment.current[0]) for segment in data]
    return float(np.median(lengths))


def smoothing_current(machine: RotatingMachine, scales: Scales) -> float:
    """Return the phase current below which the inverter's sign is smoothed [A]."""
    return machine.inverter_current or SMOOTHING * (machine.rated_current or scales.current)


def offset_std(machine: RotatingMachine, scales: Scales) -> float:
    """Return the prior standard deviation of the current offsets [A]."""
    return OFFSET_SHARE * (machine.rated_current or scales.current)


def cut_segments(
    log: Log,
    machine: RotatingMachine,
    seconds: float,
) -> tuple[list[Segment], Scales]:
    """Cut a log into segments at gaps and after `seconds` or TURNS, whichever is longer.

    The observer's most certain row gives the initial flux of a segment. Segments in which the
    observer never knows the position are skipped.

    Raises
    ------
    FluxobsError
        No segment remains.
    """
    observer, scales = plain_for(log, machine)
    segments: list[Segment] = []
    smoothing = smoothing_current(machine, scales)
    for excerpt in excerpts(log):
        settings = machine.R_s, smoothing, offset_std(machine, scales), seconds
        segments += cut_excerpt(observer, excerpt.current, excerpt.voltage, *settings)
    if not segments:
        raise FluxobsError(
            f"{log.table.path}: the position is never known, so no parameter can be identified. "
            f"Does the machine turn? Look at the warnings of `fluxobs estimate`"
        )
    return segments, scales


def cut_excerpt(
    observer: LeastSquaresObserver,
    current: Array,
    voltage: Array,
    R_s: float,
    smoothing: float,
    offset: float,
    seconds: float,
) -> list[Segment]:
    """Cut an excerpt of a log, with currents and voltages (rows, 2), into segments."""
    h, segments = observer.sample_time, []
    estimate = observer.run(voltage, current)
    missing = ~np.isfinite(current).all(axis=1) | ~np.isfinite(voltage).all(axis=1)
    good: NDArray[np.bool_] = np.logical_not(missing)
    speed = np.abs(estimate.speed_e[estimate.valid])
    turns_time = TURNS * 2 * np.pi / np.median(speed) if len(speed) else 0.0
    rows = max(SHORTEST, round(max(seconds, turns_time) / h))
    voltage = without_kinks(voltage, observer.held, axis=0)
    for run in _runs_of_rows(good, rows):
        valid = np.flatnonzero(estimate.valid[run])
        if len(valid):
            best_row = valid[np.argmin(estimate.theta_e_std[run][valid])]
            start, drift = estimate.flux[run][best_row], estimate.drift[run][best_row]
            arrays = current[run], voltage[run]
            psi = estimate.psi_f[run][valid]
            lengths = np.quantile(psi, [0.02, 0.98])
            signs = _integrate_signs(h, mean_current(current[run], axis=0), smoothing, offset)
            segments.append(_make_segment(h, *arrays, R_s, signs, best_row, start, drift, lengths))
    return segments


def _runs_of_rows(good: NDArray[np.bool_], rows: int) -> Iterator[slice]:
    """Yield runs of about `rows` good rows; no run is shorter than SHORTEST."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(int)))
    for first, last in edges.reshape(-1, 2):
        count = max(1, round((last - first) / rows))
        bounds = np.linspace(first, last, count + 1).astype(int)
        for low, high in pairwise(bounds):
            if high - low >= SHORTEST:
                yield slice(int(low), int(high))


def _make_segment(
    h: float,
    current: Array,
    voltage: Array,
    R_s: float,
    signs: tuple[Array, Array, Array, Array],
    best_row: int,
    flux: Array,
    drift: Array,
    lengths: Array,
) -> Segment:
    mean = mean_current(current, axis=0)
    integrals = [h * np.cumsum(x, axis=-2) for x in (voltage, mean)]
    u, i = (x - x[..., :1, :] for x in integrals)
    t = np.asarray(h * np.arange(len(current)), float)
    start = flux - (u - R_s * i)[best_row] - drift * t[best_row]
    return Segment(t, current, u, i, *signs, start, drift, lengths)


def _integrate_signs(
    h: float, mean: Array, smoothing: float, offset: float
) -> tuple[Array, Array, Array, Array]:
    """Return ∫ of the inverter's direction [s] and its changes.

    Three causes change the integral: harder knees, current offsets, and a loss that grows with the
    current.
    """

    def integral(values: Array) -> Array:
        total = h * np.cumsum(values, axis=0)
        return np.asarray(total - total[:1])

    def direction(current: Array) -> Array:
        return inverter_direction(current, smoothing)

    usual = direction(mean)
    harder_changes = [inverter_direction(mean, share * smoothing) - usual for share in HARDER]
    # The difference spans likely offsets: a knee may be narrower than a sample's current step.
    offset_changes = [
        (direction(mean - step) - direction(mean + step)) / (2 * offset)
        for step in offset * np.eye(2)
    ]
    share = mean / (smoothing / SMOOTHING)
    curve = share * (1 - np.hypot(*share.T))[:, None]
    harder, offsets = (
        np.stack(list(map(integral, changes))) for changes in (harder_changes, offset_changes)
    )
    return integral(usual), harder, offsets, integral(curve)
