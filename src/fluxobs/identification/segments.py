"""Contiguous pieces of a log, integrated, as the fit needs them."""

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

#: A piece, over which the drift is taken as constant, lasts this many turns, at least this long
#: [s], and is no shorter than this many rows.
TURNS, SECONDS, SHORTEST = 2.5, 0.4, 100
#: A cage's flux stands within this share of its usual length: a wrong R_s makes less of it, field
#: weakening more.
SAME_FLUX = 0.08
#: Harder knees of the inverter's sign, as shares of the usual one: with all three any usual curve
#: is met so well that R_s and V_d are right (tests/identification/test_identify.py); with the last
#: one alone, V_d of the demo log came out 7 % too large.
HARDER = (0.45, 0.2)


@dataclass(frozen=True, eq=False)
class Piece:
    """Rows without a gap; integrals start at the first row.

    Attributes
    ----------
    t : (rows,) array
        Time since the first row [s].
    current : (rows, 2) array
        [A].
    voltage : (lags, rows, 2) array
        ∫ u dt [Vs], for each of the lags.
    charge : (rows, 2) array
        ∫ i dt [As].
    inverter : (rows, 2) array
        ∫ of the inverter's direction [s]; V_d times this is lost.
    harder : (2, rows, 2) array
        By how much it differs with harder knees [s].
    offset : (2, rows, 2) array
        By how much it differs with an ampere of offset in α, and in β, of the currents [s/A].
    curve : (rows, 2) array
        By how much it differs if the loss goes on to grow with the current [s].
    start : (2,) array
        Flux at the first row, from the observer [Wb].
    drift : (2,) array
        Drift, from the observer [V].
    lengths : (2,) array
        Least and largest length of the position vector, from the observer [Wb].
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


def typical_length(data: Sequence[Piece], inductance: float) -> float:
    """Median over the pieces of the length of λ - L i, from the observer [Wb]."""
    lengths = [np.linalg.norm(piece.start - inductance * piece.current[0]) for piece in data]
    return float(np.median(lengths))


def smoothing_current(machine: RotatingMachine, scales: Scales) -> float:
    """Phase current below which the inverter's sign is smoothed [A]."""
    return machine.inverter_current or SMOOTHING * (machine.rated_current or scales.current)


def offset_std(machine: RotatingMachine, scales: Scales) -> float:
    """Standard deviation of the currents' offsets before the log [A]."""
    return OFFSET_SHARE * (machine.rated_current or scales.current)


def pieces(
    log: Log,
    machine: RotatingMachine,
    lags: tuple[int, ...],
    seconds: float = SECONDS,
    moving: bool = False,
) -> tuple[list[Piece], Scales]:
    """Cut the log where samples are missing and where pieces get longer than `seconds` or some
    turns.

    Each piece starts from the observer's flux at its most certain row. Pieces in which the observer
    never knows the position are left out.

    Raises
    ------
    FluxobsError
        No piece is left.
    """
    observer, scales = plain_for(log, machine)
    found: list[Piece] = []
    smoothing = smoothing_current(machine, scales)
    for parts in zip(*(excerpts(log.lagged(lag)) for lag in lags), strict=True):
        voltage = np.stack([part.voltage for part in parts])
        settings = lags.index(0), machine.R_s, smoothing, offset_std(machine, scales), seconds
        found += cut(observer, parts[0].current, voltage, *settings)
    if machine.flux_moves and found and not moving:
        found = _same_flux(found)
        if not found:
            raise FluxobsError(
                f"{log.table.path}: the rotor flux changes all the time in it; a log in which it "
                f"stands for {SECONDS:g} s tells the parameters"
            )
    if not found:
        raise FluxobsError(
            f"{log.table.path}: the position is never known in it, so nothing can be identified; "
            f"does the machine turn, and do `fluxobs estimate` and its warnings look right?"
        )
    return found, scales


def _same_flux(found: list[Piece]) -> list[Piece]:
    """The pieces in which the flux stands at its usual length."""
    usual = float(np.median([piece.lengths.mean() for piece in found]))
    return [p for p in found if np.abs(p.lengths - usual).max() < SAME_FLUX * usual]


def cut(
    observer: LeastSquaresObserver,
    current: Array,
    voltage: Array,
    given: int,
    R_s: float,
    smoothing: float,
    offset: float,
    seconds: float,
) -> list[Piece]:
    """Cut a stretch, (rows, 2) and (lags, rows, 2), into pieces; the observer uses lag `given`."""
    h, found = observer.sample_time, []
    estimate = observer.run(voltage[given], current)
    missing = ~np.isfinite(current).all(axis=1) | ~np.isfinite(voltage).all(axis=(0, 2))
    good: NDArray[np.bool_] = np.logical_not(missing)
    speed = np.abs(estimate.speed_e[estimate.valid])
    turns = TURNS * 2 * np.pi / np.median(speed) if len(speed) else 0.0
    rows = max(SHORTEST, round(max(seconds, turns) / h))
    voltage = without_kinks(voltage, observer.held, axis=1)
    for run in _runs(good, rows):
        valid = np.flatnonzero(estimate.valid[run])
        if len(valid):
            known = valid[np.argmin(estimate.theta_e_std[run][valid])]
            start, drift = estimate.flux[run][known], estimate.drift[run][known]
            arrays = current[run], voltage[:, run]
            psi = estimate.psi_f[run][valid]
            lengths = np.quantile(psi, [0.02, 0.98])
            signs = _signs(h, mean_current(current[run], axis=0), smoothing, offset)
            found.append(_piece(h, *arrays, given, R_s, signs, known, start, drift, lengths))
    return found


def _runs(good: NDArray[np.bool_], rows: int) -> Iterator[slice]:
    """Yield stretches of good rows, about `rows` long, none shorter than SHORTEST."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(int)))
    for first, last in edges.reshape(-1, 2):
        count = max(1, round((last - first) / rows))
        bounds = np.linspace(first, last, count + 1).astype(int)
        for low, high in pairwise(bounds):
            if high - low >= SHORTEST:
                yield slice(int(low), int(high))


def _piece(
    h: float,
    current: Array,
    voltage: Array,
    given: int,
    R_s: float,
    signs: tuple[Array, Array, Array, Array],
    known: int,
    flux: Array,
    drift: Array,
    lengths: Array,
) -> Piece:
    mean = mean_current(current, axis=0)
    integrals = [h * np.cumsum(x, axis=-2) for x in (voltage, mean)]
    u, i = (x - x[..., :1, :] for x in integrals)
    t = np.asarray(h * np.arange(len(current)), float)
    start = flux - (u[given] - R_s * i)[known] - drift * t[known]
    return Piece(t, current, u, i, *signs, start, drift, lengths)


def _signs(
    h: float, mean: Array, smoothing: float, offset: float
) -> tuple[Array, Array, Array, Array]:
    """∫ of the inverter's direction [s]; what a harder knee, offsets of the currents, and a loss
    that grows with the current change."""

    def integral(values: Array) -> Array:
        found = h * np.cumsum(values, axis=0)
        return np.asarray(found - found[:1])

    def of(current: Array) -> Array:
        return inverter_direction(current, smoothing)

    usual = of(mean)
    hard = [inverter_direction(mean, share * smoothing) - usual for share in HARDER]
    # A difference over the offsets that are likely: a knee may be narrower than a sample's step.
    moved = [(of(mean - step) - of(mean + step)) / (2 * offset) for step in offset * np.eye(2)]
    share = mean / (smoothing / SMOOTHING)
    curve = share * (1 - np.hypot(*share.T))[:, None]
    harder, offsets = (np.stack(list(map(integral, one))) for one in (hard, moved))
    return integral(usual), harder, offsets, integral(curve)
