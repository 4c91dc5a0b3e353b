"""Stretches of a log of a few turns each, from as many operating points as there are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array
from ..errors import FluxobsError
from ..logs.log import Log
from ..logs.scales import excerpts
from ..machines import RotatingMachine
from ..machines.model.held import without_kinks

Complex = NDArray[np.complex128]
Change = Callable[[Complex], Complex]

#: Lags of the voltage that are tried, relative to the given one [samples].
LAGS = (-2, -1, 0, 1, 2)
#: A stretch lasts this many turns, at least this long [s] and so many rows; over it the drift is
#: taken as constant.
TURNS, SECONDS, SHORTEST = 3.0, 0.05, 100
#: At most this many stretches are examined.
STRETCHES = 10
#: Stretches with less than this share of the largest EMF are left out: it is hidden there.
SLOW = 0.15
#: Gaps of up to this many rows are bridged.
BRIDGED = 5
#: A row that leaves the line between its neighbours by this many times what is usual, by so much of
#: the signal, and by more than twice what these differ, is a spike.
SPIKE, SPIKE_LEAST = 30.0, 0.5
#: Values beyond are no measurements [A], [V]; squared they would be no numbers.
ABSURD = 1e12


@dataclass(frozen=True, eq=False)
class Stretches:
    """Stretches of equal length; vectors are complex, α + j β.

    Attributes
    ----------
    sample_time : float
        [s].
    current : (stretches, rows) array
        [A].
    voltage : mapping of int to (stretches, rows) array
        Mean over the interval that ends at the row [V], for each of LAGS.
    truth : (stretches, rows) array, optional
        The truth channel, in its own unit.
    """

    sample_time: float
    current: Complex
    voltage: dict[int, Complex]
    truth: Array | None


def _same(values: Complex) -> Complex:
    return values


def _complex(values: Array) -> Complex:
    return np.asarray(values[:, 0] + 1j * values[:, 1])


def _measured(values: Complex) -> Complex:
    """NaN where a value is no measurement."""
    return np.where(np.abs(values) < ABSURD, values, np.nan)


def _bridge(values: Complex) -> Complex:
    """Interpolate across short gaps; longer ones stay."""
    values = _measured(values)
    bad = np.isnan(values)
    if not bad.any() or bad.all():
        return values
    k, good = np.arange(len(values)), np.flatnonzero(~bad)
    out = values.copy()
    edges = np.flatnonzero(np.diff(np.concatenate([[0], bad.astype(int), [0]]))).reshape(-1, 2)
    for low, high in edges:
        if high - low <= BRIDGED:
            out[low:high] = np.interp(k[low:high], good, values[good])
    return out


def without_spikes(values: Complex) -> tuple[Complex, int]:
    """Replace rows that leave their neighbours' line and come back; their number."""
    values = _measured(values)
    out = values.copy()
    off = values[1:-1] - (values[2:] + values[:-2]) / 2
    size = np.abs(off)
    usual = float(np.nanmedian(size)) if np.isfinite(size).any() else 0.0
    least = SPIKE_LEAST * float(np.nanstd(values)) if np.isfinite(size).any() else 0.0
    with np.errstate(invalid="ignore"):
        spike = (size > max(SPIKE * usual, least)) & (size > 2 * np.abs(values[2:] - values[:-2]))
    # the neighbours of a spike leave their line too, by half as much
    padded = np.concatenate([[0.0], np.where(spike, size, 0.0), [0.0]])
    spike &= (padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:])
    at = np.flatnonzero(spike) + 1
    out[at] = (values[at + 1] + values[at - 1]) / 2
    return out, len(at)


def _cleaned(values: Array) -> Complex:
    """As complex numbers, without short gaps and spikes."""
    return without_spikes(_bridge(_complex(values)))[0]


def _rows(voltage: list[Complex], sample_time: float) -> int:
    """Rows of a stretch, from the speed at which the voltage turns."""
    speeds = []
    for u in voltage:
        for part in np.array_split(u, max(1, len(u) // 512)):
            product = np.nansum(part[1:] * part[:-1].conj()) if len(part) > 1 else 0.0
            weight = float(np.nanmean(np.abs(part))) if np.isfinite(part).any() else 0.0
            speeds.append((weight, abs(float(np.angle(product))) / sample_time))
    most = max(weight for weight, _ in speeds)
    fast = [speed for weight, speed in speeds if weight >= most / 2]
    speed = float(np.median(fast))
    turns = TURNS * 2 * np.pi / speed if speed > 0 else 0.0
    longest = max(len(u) for u in voltage)
    return int(min(max(SHORTEST, round(max(SECONDS, turns) / sample_time)), longest))


def _resistance(voltage: list[Complex], current: list[Complex], given: float) -> float:
    """The resistance, or less where the log shows that it is less, as with currents in mA."""
    u, i = np.concatenate(voltage), np.concatenate(current)
    good = np.isfinite(u) & np.isfinite(i)
    most = float(np.vdot(i[good], u[good]).real) / (float(np.sum(np.abs(i[good]) ** 2)) + 1e-300)
    return min(given, max(most, 0.0))


def _spread(features: Array) -> list[int]:
    """Indices of rows far from one another, the first the one with the largest first feature."""
    chosen = [int(np.argmax(features[:, 0]))]
    distance = np.full(len(features), np.inf)
    while len(chosen) < min(STRETCHES, len(features)):
        distance = np.minimum(distance, np.linalg.norm(features - features[chosen[-1]], axis=1))
        distance[chosen] = -1.0
        chosen.append(int(np.argmax(distance)))
    return sorted(chosen)


def stretches(
    log: Log, machine: RotatingMachine, current_as: Change = _same, voltage_as: Change = _same
) -> Stretches:
    """Cut stretches out of a log of a machine with about this resistance.

    They are chosen as if the vectors were changed by `current_as` and `voltage_as`, but not
    changed.

    Raises
    ------
    FluxobsError
        No stretch of the log is free of gaps.
    """
    current: list[Complex] = []
    voltage: list[Complex] = []
    truths: list[Array | None] = []
    share = machine.held_share(log.held, log.sample_time)
    for part in excerpts(log):
        current.append(_cleaned(part.current))
        voltage.append(without_kinks(_cleaned(part.voltage), share))
        truths.append(part.truth)
    right, right_u = [current_as(i) for i in current], [voltage_as(u) for u in voltage]
    least = _resistance(right_u, right, machine.R_s)
    emf = [u - least * i for u, i in zip(right_u, right, strict=True)]
    rows = _rows(emf, log.sample_time)
    places, features = [], []
    for k, i in enumerate(current):
        good = np.isfinite(i) & np.isfinite(voltage[k])
        for first in range(0, len(i) - rows + 1, max(1, rows // 2)):
            # other lags take voltages from beyond both ends
            if not good[max(0, first + LAGS[0]) : first + rows + LAGS[-1]].all():
                continue
            cut = slice(first, first + rows)
            u, size = emf[k][cut], float(np.abs(right[k][cut]).mean())
            angle = np.vdot(u, right[k][cut]) / (np.abs(u).sum() + 1e-300)
            places.append((k, cut))
            features.append([float(np.abs(u).mean()), size, angle.real, angle.imag])
    if not places:
        raise FluxobsError(
            f"{log.path}: no {rows} rows of it are free of gaps, so it cannot be checked"
        )
    scaled = np.array(features)
    scaled /= np.array([scaled[:, 0].max(), *([scaled[:, 1].max()] * 3)]) + 1e-300
    lively = np.flatnonzero(scaled[:, 0] >= SLOW)
    chosen = [places[lively[n]] for n in _spread(scaled[lively])]
    return Stretches(
        log.sample_time,
        np.stack([current[k][cut] for k, cut in chosen]),
        {
            lag: _lagged(log, lag, share, chosen)
            if lag
            else np.stack([voltage[k][cut] for k, cut in chosen])
            for lag in LAGS
        },
        _truth([truths[k] for k, _ in chosen], [cut for _, cut in chosen]),
    )


def _lagged(log: Log, lag: int, share: float, places: list[tuple[int, slice]]) -> Complex:
    """The voltages at these places (excerpt, rows) with another lag."""
    found: dict[int, Complex] = {}
    wanted = {k for k, _ in places}
    for k, part in enumerate(excerpts(log.lagged(lag))):
        if k in wanted:
            found[k] = without_kinks(_cleaned(part.voltage), share)
    # nothing is known from beyond the ends of the log
    return np.nan_to_num(np.stack([found[k][cut] for k, cut in places]))


def _truth(parts: list[Array | None], cuts: list[slice]) -> Array | None:
    found = [part[cut] for part, cut in zip(parts, cuts, strict=True) if part is not None]
    return np.stack(found) if len(found) == len(parts) else None
