"""Time of a log: steps, gaps, counter wraps, rounding and jitter of its time stamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...core.arrays import Array
from ...errors import RecordError
from ..formats import Table, read_rows

#: A step longer than this is a gap [sample times].
GAP = 1.6
#: Largest deviation of a step that counts as uniform [share of the sample time].
EVEN = 0.02
#: If steps deviate by more, they have no common sample rate [share of the sample time].
JITTER = 0.45
#: Limit instead of JITTER if the user gives the sample time: t may then be rounded irregularly.
JITTER_GIVEN = 0.9
#: Smallest rounding of stamps that is reported [share of the sample time].
ROUNDED = 0.2
#: If a step is this close to a multiple of the rounding, rounding does not change the step.
WHOLE = 0.02
#: Largest clock drift [share of the elapsed time].
WANDERS = 1e-3
#: A gap longer than this many rows is shortened to this length; times after the gap stay correct.
LONGEST_GAP = 10_000
#: Counters of ticks, milli-, micro- or nanoseconds wrap at powers of two; clocks wrap at 24 h.
_BITS = (8, 10, 12, 16, 24, 32)
WRAPS = (86400.0, *(2.0**n / unit for unit in (1.0, 1e3, 1e6, 1e9) for n in _BITS))
#: Longest step across a wrap [sample times]. A few samples may be missing at a wrap, but a second
#: log appended to the first log is not a wrap.
WRAP_STEP = 16.5
_HEAD_ROWS = 65536
_BATCH_ROWS = 200_000
#: Spacing of the time index [rows], which locates rows whose stamps jitter. The spacing is less
#: than half a turn of the shortest counter, which has eight bits.
INDEXED = 64


@dataclass(frozen=True, eq=False)
class Clock:
    """Relation between uniform rows and the rows of the file.

    Attributes
    ----------
    sample_time, t0 : float
        [s].
    rows : int
        Number of uniform rows, including rows in gaps.
    source, at, t : (pieces,) ndarray
        First row of each gap-free segment: its number in the file, its number among the uniform
        rows, and its time [s].
    missing : int
        Number of samples missing in gaps.
    rounding, jitter : float
        Resolution of the stamps, and rms of their other deviations [s].
    index : (n,) ndarray
        Unwrapped time of every INDEXED-th row of the file [s].
    wrap : float
        Time added to the stamps at each wrap [s]; 0 if there is no wrap.
    """

    sample_time: float
    t0: float
    rows: int
    source: NDArray[np.int64]
    at: NDArray[np.int64]
    t: Array
    missing: int
    rounding: float
    jitter: float
    index: Array
    wrap: float

    @property
    def plain(self) -> bool:
        """Whether the rows of the file are already uniform, without gaps or wraps."""
        return len(self.at) == 1 and not self.wrap

    @property
    def end(self) -> float:
        """Time of the last row [s]."""
        return float(self.t[-1] + (self.rows - 1 - self.at[-1]) * self.sample_time)

    def times(self, rows: NDArray[np.int64]) -> Array:
        """Return the times of uniform rows [s]."""
        piece = np.searchsorted(self.at, rows, side="right") - 1
        t = self.t[piece] + (rows - self.at[piece]) * self.sample_time
        if len(self.at) > 1:  # times of rows in a shortened gap stay before the end of the gap
            after = np.append(self.t[1:], np.inf)[piece]
            t = np.minimum(t, after - 1e-9 * self.sample_time)
        return np.asarray(t)

    def row_at(self, t: float, up: bool) -> int:
        """Return the first row at or after a time. If `up` is false, return the row after the last
        row that is at or before the time.
        """
        piece = max(0, int(np.searchsorted(self.t, t, side="right")) - 1)
        samples = (t - self.t[piece]) / self.sample_time
        offset = int(np.ceil(samples - 1e-6)) if up else int(np.floor(samples + 1e-6)) + 1
        end = self.at[piece + 1] if piece + 1 < len(self.at) else self.rows
        return int(np.clip(self.at[piece] + offset, 0, end))

    def uniform_rows(self, source: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the numbers of the uniform rows that correspond to rows of the file."""
        piece = np.searchsorted(self.source, source, side="right") - 1
        return np.asarray(self.at[piece] + source - self.source[piece])


def even(rows: int, sample_time: float, t0: float = 0.0) -> Clock:
    """Return the clock of uniform rows."""
    zero = np.zeros(1, np.int64)
    index = np.asarray(t0 + sample_time * np.arange(0, rows, INDEXED), float)
    return Clock(sample_time, t0, rows, zero, zero, np.array([t0]), 0, 0.0, 0.0, index, 0.0)


def longest_step(h: float, rounding: float) -> float:
    """Return the longest step [s] that is not a gap, for sample time `h` and `rounding` [s]."""
    return GAP * h + (rounding if rounding >= ROUNDED * h else 0.0)


def missing_steps(steps: Array, h: float, rounding: float) -> NDArray[np.int64]:
    """Return the number of samples that are missing in each step of the stamps."""
    lacking = np.maximum(1, np.round(steps / h) - 1)
    return np.where(steps > longest_step(h, rounding), lacking, 0).astype(np.int64)


class _Reader:
    """Single pass over the time column."""

    def __init__(self, table: Table, column: str, scale: float, offset: float, given: float | None):
        self.table, self.column, self.scale, self.offset = table, column, scale, offset
        head = self._read(0, min(table.rows, _HEAD_ROWS))
        self.t0 = float(head[0])
        self.wrap, self.wrapped = 0.0, 0.0
        self._check_missing(head, 0)
        head = self._unwrapped(head, 0)
        self.rounding = rounding_of(head)
        if self.rounding and not is_rounded(head, self.rounding):
            self.rounding = 0.0  # the sample times themselves are multiples of this size
        if given and self.rounding and _is_whole(given / self.rounding):
            self.rounding = 0.0  # rounding changes no stamp
        steps = np.diff(head)
        if not np.median(steps) > 0 and not self.rounding > 0:
            self._backwards(head, 0, int(np.argmax(steps <= 0)))
        self.step, self.typical = self._typical(steps)
        if not self.step > 0:
            self._backwards(head, 0, 0)
        if given is None and self.rounding and _is_whole(self.typical / self.rounding):
            self.rounding = 0.0
        self.mean = float(head[-1] - head[0]) / len(steps)
        self.given = given
        self.wrapped = 0.0

    def _read(self, first: int, last: int) -> Array:
        t = read_rows(self.table, [self.column], first, last)[self.column]
        return np.asarray(t * self.scale + self.offset)

    def _typical(self, steps: Array) -> tuple[float, float]:
        """Return (step, mean): the step that gaps are compared with, and the mean of such steps."""
        usual = float(np.median(steps))
        if usual > 0 and self.rounding < ROUNDED * usual:
            typical = steps[np.abs(steps - usual) <= 0.6 * usual]
            return usual, float(typical.mean())
        mean = float(steps.mean())
        for _ in range(3):  # leave gaps out of the mean
            mean = float(steps[steps <= GAP * mean + 1.5 * self.rounding].mean())
        return mean, mean

    def _place(self, row: int) -> str:
        return f"{self.table.path}, {self.table.place(row)}"

    def _check_missing(self, t: Array, row: int) -> None:
        finite = np.isfinite(t)
        if not finite.all():
            raise RecordError(
                f"{self._place(row + int(np.argmin(finite)))}: t is missing. If the samples are "
                f"uniform, ignore t with --sample-time and --column t=-"
            )

    def _backwards(self, t: Array, row: int, at: int) -> None:
        raise RecordError(
            f"{self._place(row + at + 1)}: time runs backwards or stands still, {t[at]:.9g} s then "
            f"{t[at + 1]:.9g} s. Cut the log there; if the samples are uniform, ignore t with "
            f"--sample-time and --column t=-"
        )

    def _unwrapped(self, t: Array, row: int) -> Array:
        """Return stamps without the jumps of a counter that wraps."""
        steps = np.diff(t)
        back = np.flatnonzero(steps < 0)
        if len(back) == 0:
            return np.asarray(t + self.wrapped)
        if not self.wrap:
            usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
            raw = t - self.offset
            self.wrap = next(
                (
                    size
                    for size in sorted(self.scale * np.array(WRAPS) if self.scale != 1 else WRAPS)
                    if raw.max() <= size * (1 + 1e-9)
                    and 0.5 <= (steps[back[0]] + size) / max(usual, 1e-300) <= WRAP_STEP
                ),
                0.0,
            )
        if not self.wrap or (steps[back] + self.wrap <= 0).any():
            self._backwards(t, row, int(back[0]))
        jumps = np.concatenate([[0.0], self.wrap * np.cumsum(steps < 0)])
        unwrapped = t + self.wrapped + jumps
        self.wrapped += float(jumps[-1])
        return np.asarray(unwrapped)

    def clock(self) -> Clock:
        """Read the whole column; raise RecordError if its steps are not uniform."""
        h = self.given or self.step
        slack = max(EVEN * h, 1.05 * self.rounding)
        limit = (JITTER if self.given is None else JITTER_GIVEN) * h
        segment_rows, segment_times, skipped = [0], [self.t0], [0]
        index: list[Array] = []
        previous, row, total, count, squares = np.nan, 0, 0.0, 0, 0.0
        worst, worst_row, worst_step = 0.0, 0, h
        for batch in self.table.batches([self.column], 0, self.table.rows, _BATCH_ROWS):
            t = np.asarray(batch[self.column] * self.scale + self.offset)
            self._check_missing(t, row)
            stamps = t if np.isnan(previous) else np.concatenate([[previous], t])
            first = row - (len(stamps) - len(t))
            unwrapped = self._unwrapped(stamps, first)
            previous = float(t[-1])
            steps = np.diff(unwrapped)
            new_times = unwrapped[len(stamps) - len(t) :]
            index.append(new_times[-row % INDEXED :: INDEXED])
            if self.rounding < ROUNDED * h and (steps <= 0).any():
                self._backwards(unwrapped, first, int(np.argmax(steps <= 0)))
            lacking = missing_steps(steps, h, self.rounding)
            gap_steps = np.flatnonzero(lacking)
            for n in gap_steps:
                segment_rows.append(first + int(n) + 1)
                segment_times.append(float(unwrapped[n + 1]))
                skipped.append(int(lacking[n]))
            ordinary = np.delete(steps, gap_steps)
            deviation = np.abs(ordinary - (self.given or self.typical))
            total, count = total + float(ordinary.sum()), count + len(ordinary)
            squares += float(np.sum(deviation**2))
            if len(deviation) and (largest := float(deviation.max())) > worst:
                worst = largest
                at = int(np.flatnonzero(np.abs(steps - (self.given or self.typical)) == largest)[0])
                worst_row, worst_step = first + at + 1, float(steps[at])
            row += len(t)
        if worst > max(limit, slack):
            raise RecordError(
                f"{self._place(worst_row)}: samples are not uniform: a step of {worst_step:.6g} s "
                f"where {self.typical:.6g} s is expected (worst place). Steps may differ by "
                f"{limit / h:.0%}; gaps must be whole samples. Export simulations with a fixed "
                f"step; if t is only rounded, ignore t with --sample-time and --column t=-"
            )
        jitter = float(np.sqrt(squares / max(count, 1) / 2)) if worst > slack else 0.0
        return self._assemble(
            segment_rows, segment_times, skipped, total / max(count, 1), count, jitter, index
        )

    def _assemble(
        self,
        segment_rows: list[int],
        segment_times: list[float],
        skipped: list[int],
        mean: float,
        count: int,
        jitter: float,
        index: list[Array],
    ) -> Clock:
        h = self.given
        if h is None:
            digits = 4 * np.finfo(float).eps * max(abs(self.t0), abs(segment_times[-1]))
            h = rounded_rate(mean, max(self.rounding, float(digits)) / max(count, 1))
        source = np.array(segment_rows, np.int64)
        missing = np.array(skipped, np.int64)
        at = source + np.cumsum(np.minimum(missing, LONGEST_GAP))
        clock = Clock(
            h,
            self.t0,
            int(self.table.rows + at[-1] - source[-1]),
            source,
            at,
            np.array(segment_times),
            int(missing.sum()),
            self.rounding if self.rounding >= ROUNDED * h else 0.0,
            jitter,
            np.concatenate(index) if index else np.zeros(0),
            self.wrap,
        )
        self._check_rate(clock)
        return clock

    def _check_rate(self, clock: Clock) -> None:
        """Raise RecordError if uniform times drift away from the stamps."""
        rows = np.arange(len(clock.index)) * INDEXED
        deviation = np.abs(clock.index - clock.times(clock.uniform_rows(rows)))
        at = int(np.argmax(deviation))
        limit = 2 * clock.sample_time + clock.rounding + WANDERS * float(np.ptp(clock.index))
        if deviation[at] > limit:
            raise RecordError(
                f"{self._place(int(rows[at]))}: the sample rate changes: with a mean "
                f"step of {clock.sample_time:.6g} s, t is {deviation[at]:.3g} s off here. Cut the "
                f"log where the rate changes (--from, --to)"
            )


def _is_whole(share: float) -> bool:
    return abs(share - round(share)) < WHOLE and round(share) > 0


def rounding_of(t: Array) -> float:
    """Return the resolution of stamps [s], or 0 if the stamps have many digits.

    The resolution is the largest power of ten, times 1, 2 or 5, of which all stamps are multiples.
    """
    t = t - t[0]
    step = float(np.median(np.diff(t))) or float(t[-1]) / max(len(t) - 1, 1)
    if not step > 0:
        return 0.0
    scale = max(float(np.abs(t).max()), 1e-300)
    for power in range(int(np.floor(np.log10(step))) + 2, int(np.log10(step)) - 5, -1):
        for digit in (5.0, 2.0, 1.0):
            size = digit * 10.0**power
            if size < 4 * scale * np.finfo(float).eps:
                return 0.0
            if np.abs(t / size - np.round(t / size)).max() < 1e-3:
                return size
    return 0.0


#: Rows of a window. In a window, rounded stamps deviate from a line by at most their rounding.
WINDOW = 256


def is_rounded(t: Array, size: float) -> bool:
    """Return whether stamps are rounded times of uniform samples, without missing samples.

    The distance of such stamps from a line stays within the rounding in most windows.
    """
    rows = min(WINDOW, len(t))
    windows = t[: len(t) // rows * rows].reshape(-1, rows)
    k = np.arange(rows) - (rows - 1) / 2
    centred = windows - windows.mean(axis=1, keepdims=True)
    residual = centred - (centred @ k / (k @ k))[:, None] * k
    return bool(np.mean(np.ptp(residual, axis=1) <= 1.1 * size) >= 0.5)


def rounded_rate(step: float, uncertain: float) -> float:
    """Return the sample time that agrees with a mean step and has the fewest digits.

    The digits may be those of the sample time or those of the sample rate.

    `uncertain` is the uncertainty of the mean step from the rounding of stamps [s].
    """
    if uncertain > 0:
        for digits in range(1, 8):
            rate, round_step = float(f"{1 / step:.{digits}g}"), float(f"{step:.{digits}g}")
            rounded = min((1 / rate, round_step), key=lambda candidate: abs(candidate - step))
            if abs(rounded - step) <= uncertain:
                return float(f"{rounded:.9g}")
    return float(f"{step:.9g}")


def measure(
    table: Table, column: str, scale: float, offset: float, given: float | None
) -> tuple[Clock, float, float]:
    """Return (clock, typical step, mean step) of a table from its time column [s].

    Raises
    ------
    RecordError
        A time is missing, time runs backwards, or the steps of time are not uniform; the message
        names the place.
    """
    reader = _Reader(table, column, scale, offset, given)
    if given is not None:
        # Gaps change the mean step, and rounding changes the typical step: one must agree.
        deviation = min(abs(reader.typical / given - 1), abs(reader.mean / given - 1))
        if deviation > max(1e-3, 1 / table.rows):
            raise RecordError(
                f"{table.path}: t advances by {reader.mean:.6g} s a row, but --sample-time is "
                f"{given:.6g} s. Correct --sample-time or the unit of t (for example --unit t=ms)"
            )
    return reader.clock(), reader.typical, reader.mean
