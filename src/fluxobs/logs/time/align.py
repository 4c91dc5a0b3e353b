"""Find the difference between the clocks of two files by comparing the contents of the files."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.arrays import Array
from ...errors import RecordError
from ..formats import Table, read_rows
from ..meaning.guess import NamedTable
from ..meaning.names import read_name
from .clock import Clock
from .resample import resample

#: Number of rows of each file that are compared.
ROWS = 200_000
#: Channels that two files may have in common, in order of decreasing variability.
COMMON = ("i_a", "i_b", "i_c", "i_alpha", "i_beta", "u_a", "u_b", "udc", "speed_mech", "theta_e")
#: A correlation peak below this value is not evidence.
MINIMUM_PEAK = 0.5
#: Warn about files joined by time if their contents show a shift with a peak of at least
#: DOUBT_PEAK. The shift must be at least DOUBT_STDS standard deviations and, without a common
#: column, at least DOUBT_SAMPLES samples.
DOUBT_PEAK, DOUBT_STDS, DOUBT_SAMPLES = 0.8, 10.0, 50.0
#: A peak above this share of the largest peak makes the shift ambiguous.
AMBIGUOUS = 0.98

Side = tuple[NamedTable, Table, Clock]


def doubt_of_time(base: Side, other: Side) -> str | None:
    """Return a warning if the contents of two files show that their clocks differ."""
    try:
        shift = _compare_clocks(base, other)
    except RecordError:
        return None
    threshold = max(
        DOUBT_STDS * shift.std, (1.5 if shift.common else DOUBT_SAMPLES) * base[2].sample_time
    )
    nearest = min(abs(shift.shift), abs(shift.second or shift.shift))
    if shift.peak < DOUBT_PEAK or nearest < threshold:
        return None
    return f"{shift.note}, although both files have times: --align auto corrects this"


def aligned_by_content(base: Side, other: Side) -> tuple[float, str]:
    """Return (shift, note): the shift [s] to add to the times of `other`, and how certain it is.

    The shift maximises the correlation of a column that is in both files. Without such a column,
    the speeds at which currents and voltages turn are correlated.

    Raises
    ------
    RecordError
        The files share no signal that changes.
    """
    shift = _compare_clocks(base, other)
    note = shift.note
    if shift.peak < MINIMUM_PEAK:
        raise RecordError(
            f"{other[0].table.path}: --align auto: {note}; this correlation is too weak to rely "
            f"on. Join with --align time or index"
        )
    if shift.second is not None:
        note += f"; a shift of {shift.second:+.6g} s fits nearly as well: check the result"
    return shift.shift, note


@dataclass(frozen=True)
class _ClockShift:
    """Shift of a file's clock and its standard deviation [s].

    `peak` is the correlation. `second` is another shift that fits nearly as well. `common` tells
    whether a common column of both files was compared.
    """

    shift: float
    std: float
    peak: float
    second: float | None
    common: bool
    note: str


def _compare_clocks(base: Side, other: Side) -> _ClockShift:
    step = min(base[2].sample_time, other[2].sample_time)
    base_signals, other_signals = _signals(base), _signals(other)
    common = [channel for channel in COMMON if channel in base_signals and channel in other_signals]
    if common:
        basis = f"the column {common[0]} of both files"
        a, b = base_signals[common[0]], other_signals[common[0]]
    else:
        basis = "the speed at which currents and voltages turn"
        a, b = _turning_speed(base_signals, base[2]), _turning_speed(other_signals, other[2])
    base_start, a = _resample_evenly(base[2], a, step)
    other_start, b = _resample_evenly(other[2], b, step)
    if not (np.std(a) > 0 and np.std(b) > 0):
        raise RecordError(
            f"{other[0].table.path}: --align auto finds no signal that changes in both files; join "
            f"with --align time or index"
        )
    shift, peak, std, second = _correlate(a, b, step)
    shift += base_start - other_start
    note = (
        f"according to {basis}, the file's clock is {-shift:+.7g} s ahead (± {std:.2g} s; "
        f"correlation {peak:.3f})"
    )
    if second is not None:
        second += base_start - other_start
    return _ClockShift(shift, std, peak, second, bool(common), note)


def _signals(side: Side) -> dict[str, Array]:
    named, table, clock = side
    rows = min(ROWS, clock.rows)
    column_of: dict[str, str] = {}
    for name, column in named.columns.items():
        channel = read_name(name).channel
        if channel is not None and channel != "t":
            column_of.setdefault(channel, column)
    if not column_of:
        return {}
    columns = read_rows(table, list(dict.fromkeys(column_of.values())), 0, rows)
    return {channel: columns[column] for channel, column in column_of.items()}


def _turning_speed(signals: dict[str, Array], clock: Clock) -> Array:
    """Return the speed at which a vector turns [rad/s], smoothed over some samples."""
    for names in (("alpha", "beta"), ("a", "b")):
        for letter in "iu":
            x, y = (signals.get(f"{letter}_{name}") for name in names)
            if x is None or y is None:
                continue
            z = x + 1j * (y if names[0] == "alpha" else (x + 2 * y) / np.sqrt(3))
            return _speed(z, clock)
    if "u_ab" in signals and "u_bc" in signals:
        ab, bc = signals["u_ab"], signals["u_bc"]
        return _speed((2 * ab + bc) / 3 + 1j * bc / np.sqrt(3), clock)
    if all(f"d_{p}" in signals for p in "abc"):
        a, b, c = (signals[f"d_{p}"] for p in "abc")
        return _speed((2 * a - b - c) / 3 + 1j * (b - c) / np.sqrt(3), clock)
    return np.zeros(clock.rows)


def _speed(z: np.ndarray, clock: Clock) -> Array:
    finite = np.where(np.isfinite(z), z, 0.0)
    product = finite[1:] * finite[:-1].conj()
    width = max(8, len(z) // 500)
    smooth = np.convolve(product, np.ones(width) / width, mode="same")
    return np.append(np.angle(smooth), 0.0) / clock.sample_time


def _resample_evenly(clock: Clock, values: Array, step: float) -> tuple[float, Array]:
    """Return (first time, values) of a signal; the values are `step` apart and have no mean."""
    s = clock.times(np.arange(len(values)))
    values = np.where(np.isfinite(values), values, np.nanmean(values) if len(values) else 0.0)
    t = np.arange(s[0], s[-1], step)
    resampled = resample("smooth", s, values, t, step)
    resampled = np.where(np.isfinite(resampled), resampled, 0.0)
    return float(s[0]), np.asarray(resampled - resampled.mean())


def _correlate(a: Array, b: Array, step: float) -> tuple[float, float, float, float | None]:
    """Return (shift, correlation, standard deviation, second shift) of b's times against a.

    The second shift fits nearly as well; it is None if there is no such shift.
    """
    size = 1 << int(np.ceil(np.log2(len(a) + len(b))))
    cross = np.fft.irfft(np.fft.rfft(a, size) * np.fft.rfft(b, size).conj(), size)
    lags = np.arange(size)
    lags[len(a) :] -= size  # negative shifts; signals do not overlap for shifts below -len(b)
    overlap = np.minimum(len(a), lags + len(b)) - np.maximum(0, lags)
    norm = np.sqrt(_energy(a, lags, len(b)) * _energy(b, -lags, len(a)))
    # Where the overlap is constant, the sums are rounding errors of the transform.
    varies = norm > 1e-9 * np.sqrt((a @ a) * (b @ b))
    usable = varies & (overlap > 0.25 * min(len(a), len(b)))
    value = np.where(usable, cross / np.where(varies, norm, 1.0), -np.inf)
    order = np.argsort(lags)
    value, lags = value[order], lags[order]
    overlap = overlap[order]
    # If several peaks are similar, as for a periodic signal, use the peak with the most rows.
    at = int(np.argmax(np.where(value >= AMBIGUOUS * value.max(), overlap + value, 0)))
    at = _summit(value, at)
    peak = float(value[at])
    offset = 0.0
    if 0 < at < len(value) - 1 and np.isfinite(value[[at - 1, at + 1]]).all():
        below, above = value[at - 1], value[at + 1]
        curvature = below - 2 * peak + above
        offset = float((below - above) / (2 * curvature)) if curvature < 0 else 0.0
    else:
        curvature = -1.0
    rows = max(float(overlap[at]), 1.0)
    noise = max(1.0 - min(peak, 1.0) ** 2, 1e-12)
    std = step * float(np.sqrt(noise / (rows * max(-curvature, 1e-12))))
    # Find the largest other peak, beyond the valley next to this peak.
    far = np.abs(lags - lags[at]) > _width(value, at)
    best = int(np.argmax(np.where(far, value, -np.inf)))
    second = step * float(lags[best]) if value[best] > AMBIGUOUS * peak else None
    return step * (float(lags[at]) + offset), peak, std, second


def _summit(value: Array, at: int) -> int:
    """Return the index of the local maximum that is reached uphill from an index."""
    while 0 < at < len(value) - 1 and max(value[at - 1], value[at + 1]) > value[at]:
        at += 1 if value[at + 1] > value[at - 1] else -1
    return at


def _energy(x: Array, lags: np.ndarray, rows: int) -> Array:
    """Return, for each lag, the sum of squares of x where x overlaps a signal of `rows` rows."""
    total = np.concatenate([[0.0], np.cumsum(x**2)])
    start = np.clip(lags, 0, len(x))
    stop = np.clip(lags + rows, 0, len(x))
    return np.asarray(total[stop] - total[start])


def _width(value: Array, at: int) -> int:
    """Return the number of lags from a peak to half of its height."""
    below = np.flatnonzero(value < 0.5 * value[at])
    return int(np.abs(below - at).min()) if len(below) else len(value)
