"""Segments of a log: each lasts a few turns; their operating points differ as much as possible."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array, runs
from ..errors import FluxobsError
from ..logs.log import Log
from ..logs.quality.detect import Detector
from ..logs.quality.floating import with_back_emf
from ..logs.quality.injection import describe_injection
from ..logs.quality.marks import CLIPPED, FLOATING, HELD, NO_CURRENT, REPEATED
from ..logs.record import LAGS
from ..logs.scales import Scales, excerpts, scales_of
from ..logs.time.aligned import Aligned
from ..machines import RotatingMachine
from ..machines.model.held import without_kinks

Complex = NDArray[np.complex128]
VectorMap = Callable[[Complex], Complex]

#: A segment lasts this many turns, but at least this time [s] and this many rows. The drift is
#: assumed constant within a segment.
TURNS, SECONDS, SHORTEST = 3.0, 0.05, 100
#: Largest number of segments.
MOST_SEGMENTS = 10
#: Segments with less than this share of the largest EMF are skipped: drops and offsets hide the
#: EMF of such segments.
SLOW = 0.15
#: Gaps of at most this many rows are interpolated.
BRIDGED = 5
#: A row is a spike if its distance from the line between its neighbours exceeds three limits: SPIKE
#: times the median distance, SPIKE_LEAST times the signal's standard deviation, and twice the
#: difference between the neighbours.
SPIKE, SPIKE_LEAST = 30.0, 0.5
#: Fewest rows of the mean that removes an injected signal.
LEAST_MEAN = 8
#: More spikes than these within so many rows on each side are an injected signal.
DENSE, DENSE_ROWS = 4, 16
#: Rows with one of these marks are in no segment.
EXCLUDED = REPEATED | HELD | CLIPPED
#: Larger values [A], [V] cannot be measurements; their squares would overflow.
ABSURD = 1e12


@dataclass(frozen=True, eq=False)
class Segments:
    """Segments of equal length; vectors are complex, α + j β.

    Attributes
    ----------
    sample_time : float
        [s].
    current : (segments, rows) array
        [A].
    voltage : mapping of int to (segments, rows) array
        Mean voltage [V] over the interval that ends at the row, for each lag of LAGS.
    truth : (segments, rows) array, optional
        The truth channel, in its own unit.
    apart : int
        Distance of two rows with independent noise and equal phase of an injected signal [rows].
    """

    sample_time: float
    current: Complex
    voltage: dict[int, Complex]
    truth: Array | None
    apart: int = 1


def _identity(values: Complex) -> Complex:
    return values


def _complex(values: Array) -> Complex:
    return np.asarray(values[:, 0] + 1j * values[:, 1])


def _drop_implausible(values: Complex) -> Complex:
    """Replace implausible values by NaN."""
    return np.where(np.abs(values) < ABSURD, values, np.nan)


def _bridge_gaps(values: Complex) -> Complex:
    """Interpolate across short gaps; leave long gaps."""
    values = _drop_implausible(values)
    bad = np.isnan(values)
    if not bad.any() or bad.all():
        return values
    k, known = np.arange(len(values)), np.flatnonzero(~bad)
    bridged = values.copy()
    for start, stop in runs(bad):
        if stop - start <= BRIDGED:
            bridged[start:stop] = np.interp(k[start:stop], known, values[known])
    return bridged


def without_spikes(values: Complex) -> tuple[Complex, int]:
    """Interpolate across spikes of one row; return the signal and the number of spikes."""
    values = _drop_implausible(values)
    mended = values.copy()
    deviation = values[1:-1] - (values[2:] + values[:-2]) / 2
    size = np.abs(deviation)
    typical = float(np.nanmedian(size)) if np.isfinite(size).any() else 0.0
    smallest = SPIKE_LEAST * float(np.nanstd(values)) if np.isfinite(size).any() else 0.0
    with np.errstate(invalid="ignore"):
        spike = (size > max(SPIKE * typical, smallest)) & (
            size > 2 * np.abs(values[2:] - values[:-2])
        )
    # A spike also increases the distances of its two neighbours, by half as much.
    padded = np.concatenate([[0.0], np.where(spike, size, 0.0), [0.0]])
    spike &= (padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:])
    count = np.concatenate(
        [np.zeros(DENSE_ROWS), np.cumsum(spike), np.full(DENSE_ROWS, spike.sum())]
    )
    spike &= count[2 * DENSE_ROWS :] - count[: -2 * DENSE_ROWS] <= DENSE
    at = np.flatnonzero(spike) + 1
    mended[at] = (values[at + 1] + values[at - 1]) / 2
    return mended, len(at)


def _clean(values: Array) -> Complex:
    """Return complex numbers without short gaps and spikes."""
    return without_spikes(_bridge_gaps(_complex(values)))[0]


def _clean_voltage(rows: Aligned) -> Complex:
    """Return voltages without short gaps and spikes; in a commutation, a short voltage is real."""
    if rows.marks is not None and (rows.marks & FLOATING).any():
        return _bridge_gaps(_complex(rows.voltage))
    return _clean(rows.voltage)


def _moving_mean(values: Complex, rows: int) -> Complex:
    """Return the mean over so many rows around each row; NaN within them stays NaN."""
    known = np.nan_to_num(values)
    total = np.cumsum(np.concatenate([np.zeros(1), known]))
    first = np.maximum(np.arange(len(values)) - rows // 2, 0)
    last = np.minimum(first + rows, len(values))
    mean = (total[last] - total[first]) / (last - first)
    return np.asarray(np.where(np.isfinite(values), mean, values))


def _segment_length(voltage: list[Complex], sample_time: float) -> int:
    """Return the length of a segment, from the speed at which the voltage vector rotates."""
    speeds = []
    for u in voltage:
        for block in np.array_split(u, max(1, len(u) // 512)):
            product = np.nansum(block[1:] * block[:-1].conj()) if len(block) > 1 else 0.0
            weight = float(np.nanmean(np.abs(block))) if np.isfinite(block).any() else 0.0
            speeds.append((weight, abs(float(np.angle(product))) / sample_time))
    largest = max(weight for weight, _ in speeds)
    fast = [speed for weight, speed in speeds if weight >= largest / 2]
    speed = float(np.median(fast))
    turns = TURNS * 2 * np.pi / speed if speed > 0 else 0.0
    longest = max(len(u) for u in voltage)
    return int(min(max(SHORTEST, round(max(SECONDS, turns) / sample_time)), longest))


def _limit_resistance(voltage: list[Complex], current: list[Complex], given: float) -> float:
    """Return the minimum of the given resistance and the log's P/I², which is small for mA."""
    u, i = np.concatenate(voltage), np.concatenate(current)
    finite = np.isfinite(u) & np.isfinite(i)
    apparent = float(np.vdot(i[finite], u[finite]).real) / (
        float(np.sum(np.abs(i[finite]) ** 2)) + 1e-300
    )
    return min(given, max(apparent, 0.0))


def _choose_distant(features: Array) -> list[int]:
    """Return indices of features far from each other, starting with the largest first feature."""
    chosen = [int(np.argmax(features[:, 0]))]
    distance = np.full(len(features), np.inf)
    while len(chosen) < min(MOST_SEGMENTS, len(features)):
        distance = np.minimum(distance, np.linalg.norm(features - features[chosen[-1]], axis=1))
        distance[chosen] = -1.0
        chosen.append(int(np.argmax(distance)))
    return sorted(chosen)


def cut_segments(
    log: Log,
    machine: RotatingMachine,
    current_as: VectorMap = _identity,
    voltage_as: VectorMap = _identity,
    scales: Scales | None = None,
) -> Segments:
    """Cut segments out of a log.

    Segments are chosen by the EMF, computed with the machine's R_s and the vectors that
    `current_as` and `voltage_as` return. The segments themselves hold the vectors of the log.
    `scales` are the sizes of the log's signals; by default they are measured.

    Raises
    ------
    FluxobsError
        No segment of the log is free of gaps.
    """
    current: list[Complex] = []
    voltage: list[Complex] = []
    truths: list[Array | None] = []
    blocks = False
    share = machine.held_share(log.held, log.sample_time)
    pieces = list(excerpts(log))
    if scales is None:
        scales = scales_of(pieces, log.sample_time, log.path)
    detector = Detector(scales.current, scales.voltage, scales.current_noise)

    def marked(excerpt: Aligned) -> Aligned:
        rows = excerpt._replace(marks=detector.marks(excerpt))
        return with_back_emf(rows, machine, log.sample_time)

    faulty: list[NDArray[np.bool_]] = []
    idle: list[NDArray[np.bool_]] = []
    marked_pieces: list[Aligned] = []
    for excerpt in pieces:
        excerpt = marked(excerpt)
        marked_pieces.append(excerpt)
        marks = excerpt.marks
        assert marks is not None
        blocks |= bool((marks & FLOATING).any())
        faulty.append(np.asarray(marks & EXCLUDED > 0))
        idle.append(np.asarray(marks & NO_CURRENT > 0))
        current.append(_clean(excerpt.current))
        voltage.append(without_kinks(_clean_voltage(excerpt), share))
        truths.append(excerpt.truth)
    current_used, voltage_used = [current_as(i) for i in current], [voltage_as(u) for u in voltage]
    resistance = _limit_resistance(voltage_used, current_used, machine.R_s)
    emf = [u - resistance * i for u, i in zip(voltage_used, current_used, strict=True)]
    injection = describe_injection(marked_pieces, log.sample_time)
    if injection is not None:  # its voltage may exceed the EMF
        rows = injection.period * -(-LEAST_MEAN // injection.period)
        emf = [_moving_mean(u, rows) for u in emf]
    count = _segment_length(emf, log.sample_time)
    places, features = [], []
    carries = not all(rows.all() for rows in idle)
    for number, i in enumerate(current):
        finite = np.isfinite(i) & np.isfinite(voltage[number]) & ~faulty[number]
        if carries:  # without current the bridge may be off, and the voltages are not its own
            finite &= ~idle[number]
        for first in range(0, len(i) - count + 1, max(1, count // 2)):
            # Other lags need voltages beyond both ends of the segment.
            if not finite[max(0, first + LAGS[0]) : first + count + LAGS[-1]].all():
                continue
            cut = slice(first, first + count)
            u, size = emf[number][cut], float(np.abs(current_used[number][cut]).mean())
            angle = np.vdot(u, current_used[number][cut]) / (np.abs(u).sum() + 1e-300)
            places.append((number, cut))
            features.append([float(np.abs(u).mean()), size, angle.real, angle.imag])
    if not places:
        raise FluxobsError(
            f"{log.path}: cannot be checked: no {count} consecutive rows are free of gaps"
        )
    scaled = np.array(features)
    scaled /= np.array([scaled[:, 0].max(), *([scaled[:, 1].max()] * 3)]) + 1e-300
    moving = np.flatnonzero(scaled[:, 0] >= SLOW)
    chosen = [places[moving[n]] for n in _choose_distant(scaled[moving])]
    return Segments(
        log.sample_time,
        np.stack([current[number][cut] for number, cut in chosen]),
        {
            lag: _voltage_at_lag(log, lag, share, chosen, marked if blocks else None)
            if lag
            else np.stack([voltage[number][cut] for number, cut in chosen])
            for lag in LAGS
        },
        _stack_truth([truths[number] for number, _ in chosen], [cut for _, cut in chosen]),
        1 if injection is None else min(injection.period, count // 2),
    )


def _voltage_at_lag(
    log: Log,
    lag: int,
    share: float,
    places: list[tuple[int, slice]],
    marked: Callable[[Aligned], Aligned] | None,
) -> Complex:
    """Return the voltages of segments at another lag; a place is (excerpt, rows).

    `marked` marks the rows of a log with block commutation, and fills the floating phases.
    """
    voltages: dict[int, Complex] = {}
    needed = {number for number, _ in places}
    for number, excerpt in enumerate(excerpts(log.lagged(lag))):
        if number in needed:
            rows = excerpt if marked is None else marked(excerpt)
            voltages[number] = without_kinks(_clean_voltage(rows), share)
    # Beyond the ends of the log, the voltage is zero.
    return np.nan_to_num(np.stack([voltages[number][cut] for number, cut in places]))


def _stack_truth(truths: list[Array | None], cuts: list[slice]) -> Array | None:
    segments = [truth[cut] for truth, cut in zip(truths, cuts, strict=True) if truth is not None]
    return np.stack(segments) if len(segments) == len(truths) else None
