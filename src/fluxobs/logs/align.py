"""By how much the clocks of two files differ, from what both files saw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.arrays import Array
from ..errors import RecordError
from .clock import Clock
from .formats import Table, read_rows
from .guess import NamedTable
from .names import read_name
from .resample import resample

#: Rows of each file that are compared.
ROWS = 200_000
#: Channels that both files may have; the more a signal changes, the better.
COMMON = ("i_a", "i_b", "i_c", "i_alpha", "i_beta", "u_a", "u_b", "udc", "speed_mech", "theta_e")
#: A peak of the correlation below this says nothing.
LEAST = 0.5
#: Of files that are joined by time, a warning is due if their contents say otherwise with such a
#: peak, and by so many standard deviations, and samples.
CLEAR, SURE, FAR = 0.8, 10.0, 50.0
#: Peaks that are this close to the largest may be it as well.
ALIKE = 0.98

Side = tuple[NamedTable, Table, Clock]


def doubt_of_time(base: Side, other: Side) -> str | None:
    """A warning where the contents of two files say that their clocks differ; None otherwise."""
    try:
        found = _found(base, other)
    except RecordError:
        return None
    least = max(SURE * found.std, (1.5 if found.common else FAR) * base[2].sample_time)
    nearest = min(abs(found.shift), abs(found.second or found.shift))
    if found.peak < CLEAR or nearest < least:
        return None
    return f"{found.words}, though both have times: --align auto takes that into account"


def aligned_by_content(base: Side, other: Side) -> tuple[float, str]:
    """What is to be added to the times of `other` [s], and words on how sure that is.

    Columns that both files have are correlated with each other; otherwise how fast currents and
    voltages turn, which has to agree.

    Raises
    ------
    RecordError
        The files have nothing in common that changes.
    """
    found = _found(base, other)
    words = found.words
    if found.peak < LEAST:
        raise RecordError(
            f"{other[0].table.path}: --align auto: {words}; that is too little to rely on. Join by "
            f"--align time or index"
        )
    if found.second is not None:
        words += f"; {found.second:+.6g} s fits nearly as well, so check the result"
    return found.shift, words


@dataclass(frozen=True)
class _Found:
    """How the clock of a file differs: shift and standard deviation [s], the peak of the
    correlation, a second shift that fits as well, and whether a column is in both files."""

    shift: float
    std: float
    peak: float
    second: float | None
    common: bool
    words: str


def _found(base: Side, other: Side) -> _Found:
    step = min(base[2].sample_time, other[2].sample_time)
    one, two = _signals(base), _signals(other)
    common = [channel for channel in COMMON if channel in one and channel in two]
    if common:
        what = f"the column {common[0]} of both files"
        a, b = one[common[0]], two[common[0]]
    else:
        what = "the speed at which currents and voltages turn"
        a, b = _turning(one, base[2]), _turning(two, other[2])
    ta, a = _even(base[2], a, step)
    tb, b = _even(other[2], b, step)
    if not (np.std(a) > 0 and np.std(b) > 0):
        raise RecordError(
            f"{other[0].table.path}: --align auto finds nothing that both files saw change; join "
            f"by --align time or index"
        )
    shift, peak, std, second = _correlate(a, b, step)
    shift += ta - tb
    words = f"by {what} its clock is {-shift:+.7g} s ahead (± {std:.2g} s; correlation {peak:.3f})"
    if second is not None:
        second += ta - tb
    return _Found(shift, std, peak, second, bool(common), words)


def _signals(side: Side) -> dict[str, Array]:
    part, table, clock = side
    rows = min(ROWS, clock.rows)
    found: dict[str, str] = {}
    for name, column in part.columns.items():
        channel = read_name(name).channel
        if channel is not None and channel != "t":
            found.setdefault(channel, column)
    if not found:
        return {}
    columns = read_rows(table, list(dict.fromkeys(found.values())), 0, rows)
    return {channel: columns[column] for channel, column in found.items()}


def _turning(signals: dict[str, Array], clock: Clock) -> Array:
    """How fast a vector turns [rad/s], smoothed over some samples."""
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
    good = np.where(np.isfinite(z), z, 0.0)
    product = good[1:] * good[:-1].conj()
    width = max(8, len(z) // 500)
    smooth = np.convolve(product, np.ones(width) / width, mode="same")
    return np.append(np.angle(smooth), 0.0) / clock.sample_time


def _even(clock: Clock, values: Array, step: float) -> tuple[float, Array]:
    """A signal on steps of `step`, without mean; and its first time."""
    s = clock.times(np.arange(len(values)))
    values = np.where(np.isfinite(values), values, np.nanmean(values) if len(values) else 0.0)
    t = np.arange(s[0], s[-1], step)
    even = resample("smooth", s, values, t, step)
    even = np.where(np.isfinite(even), even, 0.0)
    return float(s[0]), np.asarray(even - even.mean())


def _correlate(a: Array, b: Array, step: float) -> tuple[float, float, float, float | None]:
    """Shift of b's times that fits a, its correlation, its standard deviation; a second one."""
    size = 1 << int(np.ceil(np.log2(len(a) + len(b))))
    cross = np.fft.irfft(np.fft.rfft(a, size) * np.fft.rfft(b, size).conj(), size)
    lags = np.arange(size)
    lags[len(a) :] -= size  # of negative shifts; those below -len(b) do not overlap
    overlap = np.minimum(len(a), lags + len(b)) - np.maximum(0, lags)
    norm = np.sqrt(_energy(a, lags, len(b)) * _energy(b, -lags, len(a)))
    # Where nothing happens in what overlaps, the sums are rounding errors of the transform.
    happens = norm > 1e-9 * np.sqrt((a @ a) * (b @ b))
    enough = happens & (overlap > 0.25 * min(len(a), len(b)))
    value = np.where(enough, cross / np.where(happens, norm, 1.0), -np.inf)
    order = np.argsort(lags)
    value, lags = value[order], lags[order]
    overlap = overlap[order]
    # of peaks that are alike, as those of a periodic signal, the one with the most rows
    at = int(np.argmax(np.where(value >= ALIKE * value.max(), overlap + value, 0)))
    at = _summit(value, at)
    peak = float(value[at])
    offset = 0.0
    if 0 < at < len(value) - 1 and np.isfinite(value[[at - 1, at + 1]]).all():
        left, right = value[at - 1], value[at + 1]
        bend = left - 2 * peak + right
        offset = float((left - right) / (2 * bend)) if bend < 0 else 0.0
    else:
        bend = -1.0
    rows = max(float(overlap[at]), 1.0)
    noise = max(1.0 - min(peak, 1.0) ** 2, 1e-12)
    std = step * float(np.sqrt(noise / (rows * max(-bend, 1e-12))))
    # another peak, beyond the valley beside this one
    far = np.abs(lags - lags[at]) > _width(value, at)
    best = int(np.argmax(np.where(far, value, -np.inf)))
    second = step * float(lags[best]) if value[best] > ALIKE * peak else None
    return step * (float(lags[at]) + offset), peak, std, second


def _summit(value: Array, at: int) -> int:
    """The local maximum uphill of a place."""
    while 0 < at < len(value) - 1 and max(value[at - 1], value[at + 1]) > value[at]:
        at += 1 if value[at + 1] > value[at - 1] else -1
    return at


def _energy(x: Array, lags: np.ndarray, other: int) -> Array:
    """Sum of squares of the part of x that overlaps the other signal at each lag."""
    total = np.concatenate([[0.0], np.cumsum(x**2)])
    start = np.clip(lags, 0, len(x))
    stop = np.clip(lags + other, 0, len(x))
    return np.asarray(total[stop] - total[start])


def _width(value: Array, at: int) -> int:
    """Lags from a peak to where it has fallen to half."""
    below = np.flatnonzero(value < 0.5 * value[at])
    return int(np.abs(below - at).min()) if len(below) else len(value)
