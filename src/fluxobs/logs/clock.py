"""The time of a log: steps, gaps, wraps, rounding and jitter of its stamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array
from ..errors import RecordError
from .formats import Table, read_rows

#: A step of so many sample times is a gap.
GAP = 1.6
#: Steps that differ from the sample time by less, as a share of it, are even.
EVEN = 0.02
#: Stamps that jitter so that steps differ by more, as a share, are no samples of one rate.
JITTER = 0.45
#: The same if the user gave the sample time: t may be rounded in ways of its own.
JITTER_GIVEN = 0.9
#: Rounding of stamps that is worth a word, as a share of the sample time.
ROUNDED = 0.2
#: Steps within this of whole numbers of the rounding are not moved by it.
WHOLE = 0.02
#: A clock wanders by less than this share of the time.
WANDERS = 1e-3
#: A longer gap is shortened to so many rows; the time goes on correctly behind it.
LONGEST_GAP = 10_000
#: Where counters start again: at powers of two, in ticks, milli- or microseconds; clocks at 24 h.
_BITS = (8, 10, 12, 16, 24, 32)
WRAPS = (86400.0, *(2.0**n / unit for unit in (1.0, 1e3, 1e6, 1e9) for n in _BITS))
#: The step over a wrap is at most so many sample times: some samples may be missing there, but a
#: second log below the first is no wrap.
WRAP_STEP = 16.5
_HEAD = 65536
_BATCH = 200_000
#: Times of every so many rows are kept, to find rows where stamps jitter: fewer than half a turn of
#: the shortest counter, of eight bits.
INDEXED = 64


@dataclass(frozen=True, eq=False)
class Clock:
    """Uniform rows, and which rows of the file they are.

    Attributes
    ----------
    sample_time, t0 : float
        [s].
    rows : int
        Uniform rows, those in gaps included.
    source, at, t : (pieces,) ndarray
        First row of each piece without gaps, in the file and among the uniform rows; its time [s].
    missing : int
        Samples that gaps lack.
    rounding, jitter : float
        Of the stamps: step of their digits, and rms of what else moves them [s].
    index : (n,) ndarray
        Time of every INDEXED-th row of the file [s], without wraps.
    wrap : float
        What is added to the stamps at each wrap [s]; 0 without.
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
        """Whether the rows of the file are the uniform rows."""
        return len(self.at) == 1 and not self.wrap

    @property
    def end(self) -> float:
        """Time of the last row [s]."""
        return float(self.t[-1] + (self.rows - 1 - self.at[-1]) * self.sample_time)

    def times(self, rows: NDArray[np.int64]) -> Array:
        """Times of uniform rows [s]."""
        piece = np.searchsorted(self.at, rows, side="right") - 1
        out = self.t[piece] + (rows - self.at[piece]) * self.sample_time
        if len(self.at) > 1:  # in a gap that was shortened time runs faster
            after = np.append(self.t[1:], np.inf)[piece]
            out = np.minimum(out, after - 1e-9 * self.sample_time)
        return np.asarray(out)

    def row_at(self, t: float, up: bool) -> int:
        """The first row at or after a time, or the last one at or before it, plus one."""
        piece = max(0, int(np.searchsorted(self.t, t, side="right")) - 1)
        at = (t - self.t[piece]) / self.sample_time
        row = int(np.ceil(at - 1e-6)) if up else int(np.floor(at + 1e-6)) + 1
        end = self.at[piece + 1] if piece + 1 < len(self.at) else self.rows
        return int(np.clip(self.at[piece] + row, 0, end))

    def uniform_rows(self, source: NDArray[np.int64]) -> NDArray[np.int64]:
        """Uniform rows of rows of the file."""
        piece = np.searchsorted(self.source, source, side="right") - 1
        return np.asarray(self.at[piece] + source - self.source[piece])


def even(rows: int, sample_time: float, t0: float = 0.0) -> Clock:
    """The clock of rows that are uniform."""
    zero = np.zeros(1, np.int64)
    index = np.asarray(t0 + sample_time * np.arange(0, rows, INDEXED), float)
    return Clock(sample_time, t0, rows, zero, zero, np.array([t0]), 0, 0.0, 0.0, index, 0.0)


def longest_step(h: float, rounding: float) -> float:
    """The longest step of stamps that is no gap [s], for a sample time and their rounding [s]."""
    return GAP * h + (rounding if rounding >= ROUNDED * h else 0.0)


def missing_steps(steps: Array, h: float, rounding: float) -> NDArray[np.int64]:
    """Samples that are missing within each step of the stamps."""
    lacking = np.maximum(1, np.round(steps / h) - 1)
    return np.where(steps > longest_step(h, rounding), lacking, 0).astype(np.int64)


class _Reader:
    """One pass over the time column."""

    def __init__(self, table: Table, column: str, scale: float, offset: float, given: float | None):
        self.table, self.column, self.scale, self.offset = table, column, scale, offset
        head = self._read(0, min(table.rows, _HEAD))
        self.t0 = float(head[0])
        self.wrap, self.wrapped = 0.0, 0.0
        self._check_missing(head, 0)
        head = self._unwrapped(head, 0)
        self.rounding = rounding_of(head)
        if self.rounding and not is_rounded(head, self.rounding):
            self.rounding = 0.0  # stamps lie on a grid because the samples do
        if given and self.rounding and _is_whole(given / self.rounding):
            self.rounding = 0.0  # it moves no stamp
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
        """Step to find gaps with, and the mean of the steps like it."""
        usual = float(np.median(steps))
        if usual > 0 and self.rounding < ROUNDED * usual:
            ordinary = steps[np.abs(steps - usual) <= 0.6 * usual]
            return usual, float(ordinary.mean())
        mean = float(steps.mean())
        for _ in range(3):  # without its gaps
            mean = float(steps[steps <= GAP * mean + 1.5 * self.rounding].mean())
        return mean, mean

    def _place(self, row: int) -> str:
        return f"{self.table.path}, {self.table.place(row)}"

    def _check_missing(self, t: Array, row: int) -> None:
        known = np.isfinite(t)
        if not known.all():
            raise RecordError(
                f"{self._place(row + int(np.argmin(known)))}: t is missing. If the samples are "
                f"uniform, --sample-time and --column t=- ignore t"
            )

    def _backwards(self, t: Array, row: int, at: int) -> None:
        raise RecordError(
            f"{self._place(row + at + 1)}: time runs backwards or stands still, {t[at]:.9g} s then "
            f"{t[at + 1]:.9g} s. Cut the log there; if the samples are uniform, --sample-time and "
            f"--column t=- ignore t"
        )

    def _unwrapped(self, t: Array, row: int) -> Array:
        """Stamps without the jumps of a counter that starts again."""
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
        out = t + self.wrapped + jumps
        self.wrapped += float(jumps[-1])
        return np.asarray(out)

    def clock(self) -> Clock:
        """Read all of it."""
        h = self.given or self.step
        slack = max(EVEN * h, 1.05 * self.rounding)
        limit = (JITTER if self.given is None else JITTER_GIVEN) * h
        rows_at, after, skipped = [0], [self.t0], [0]
        index: list[Array] = []
        before, row, total, count, square = np.nan, 0, 0.0, 0, 0.0
        worst, worst_row, worst_step = 0.0, 0, h
        for part in self.table.batches([self.column], 0, self.table.rows, _BATCH):
            t = np.asarray(part[self.column] * self.scale + self.offset)
            self._check_missing(t, row)
            joined = t if np.isnan(before) else np.concatenate([[before], t])
            known = row - (len(joined) - len(t))
            whole = self._unwrapped(joined, known)
            before = float(t[-1])
            steps = np.diff(whole)
            tail = whole[len(joined) - len(t) :]
            index.append(tail[-row % INDEXED :: INDEXED])
            if self.rounding < ROUNDED * h and (steps <= 0).any():
                self._backwards(whole, known, int(np.argmax(steps <= 0)))
            lacking = missing_steps(steps, h, self.rounding)
            gaps = np.flatnonzero(lacking)
            for n in gaps:
                rows_at.append(known + int(n) + 1)
                after.append(float(whole[n + 1]))
                skipped.append(int(lacking[n]))
            ordinary = np.delete(steps, gaps)
            off = np.abs(ordinary - (self.given or self.typical))
            total, count = total + float(ordinary.sum()), count + len(ordinary)
            square += float(np.sum(off**2))
            if len(off) and (most := float(off.max())) > worst:
                worst = most
                at = int(np.flatnonzero(np.abs(steps - (self.given or self.typical)) == most)[0])
                worst_row, worst_step = known + at + 1, float(steps[at])
            row += len(t)
        if worst > max(limit, slack):
            raise RecordError(
                f"{self._place(worst_row)}: samples are not uniform: a step of {worst_step:.6g} s "
                f"where {self.typical:.6g} s is expected (the worst place). Steps may differ by "
                f"{limit / h:.0%}, and gaps are whole samples. Export a simulation at a fixed "
                f"step; if t is only rounded, --sample-time and --column t=- ignore it"
            )
        jitter = float(np.sqrt(square / max(count, 1) / 2)) if worst > slack else 0.0
        return self._made(rows_at, after, skipped, total / max(count, 1), count, jitter, index)

    def _made(
        self,
        rows_at: list[int],
        after: list[float],
        skipped: list[int],
        mean: float,
        count: int,
        jitter: float,
        index: list[Array],
    ) -> Clock:
        h = self.given
        if h is None:
            digits = 4 * np.finfo(float).eps * max(abs(self.t0), abs(after[-1]))
            h = rounded_rate(mean, max(self.rounding, float(digits)) / max(count, 1))
        source = np.array(rows_at, np.int64)
        missing = np.array(skipped, np.int64)
        at = source + np.cumsum(np.minimum(missing, LONGEST_GAP))
        made = Clock(
            h,
            self.t0,
            int(self.table.rows + at[-1] - source[-1]),
            source,
            at,
            np.array(after),
            int(missing.sum()),
            self.rounding if self.rounding >= ROUNDED * h else 0.0,
            jitter,
            np.concatenate(index) if index else np.zeros(0),
            self.wrap,
        )
        self._check_rate(made)
        return made

    def _check_rate(self, made: Clock) -> None:
        """Uniform times have to stay near the stamps."""
        rows = np.arange(len(made.index)) * INDEXED
        off = np.abs(made.index - made.times(made.uniform_rows(rows)))
        at = int(np.argmax(off))
        near = 2 * made.sample_time + made.rounding + WANDERS * float(np.ptp(made.index))
        if off[at] > near:
            raise RecordError(
                f"{self._place(int(rows[at]))}: the sample rate changes: with steps of "
                f"{made.sample_time:.6g} s on the mean, t is {off[at]:.3g} s away here. Cut the "
                f"log where it changes (--from, --to)"
            )


def _is_whole(share: float) -> bool:
    return abs(share - round(share)) < WHOLE and round(share) > 0


def rounding_of(t: Array) -> float:
    """Step of the digits in which stamps are written [s]; 0 if they have many.

    It is the largest power of ten, times one, two or five, of which all of them are multiples.
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


#: Rows of a window in which rounded stamps leave a line by no more than their rounding.
WINDOW = 256


def is_rounded(t: Array, size: float) -> bool:
    """Whether stamps are rounded times of even samples, not times of samples with some missing:
    their distance from a line stays within the rounding, in most windows."""
    rows = min(WINDOW, len(t))
    windows = t[: len(t) // rows * rows].reshape(-1, rows)
    k = np.arange(rows) - (rows - 1) / 2
    centred = windows - windows.mean(axis=1, keepdims=True)
    left = centred - (centred @ k / (k @ k))[:, None] * k
    return bool(np.mean(np.ptp(left, axis=1) <= 1.1 * size) >= 0.5)


def rounded_rate(step: float, uncertain: float) -> float:
    """The sample time that has, or whose rate has, the fewest digits of those that agree with a
    mean step.

    `uncertain` is what the rounding of stamps leaves open [s].
    """
    if uncertain > 0:
        for digits in range(1, 8):
            rate, round_step = float(f"{1 / step:.{digits}g}"), float(f"{step:.{digits}g}")
            found = min((1 / rate, round_step), key=lambda one: abs(one - step))
            if abs(found - step) <= uncertain:
                return float(f"{found:.9g}")
    return float(f"{step:.9g}")


def measure(
    table: Table, column: str, scale: float, offset: float, given: float | None
) -> tuple[Clock, float, float]:
    """Clock of a table by its time column; also its typical step and its mean step [s].

    Raises
    ------
    RecordError
        Time is missing somewhere, runs backwards, or its steps are not even; the message says
        where.
    """
    reader = _Reader(table, column, scale, offset, given)
    if given is not None:
        # A gap moves the mean, rounding moves the typical step: either may confirm the given one.
        off = min(abs(reader.typical / given - 1), abs(reader.mean / given - 1))
        if off > max(1e-3, 1 / table.rows):
            raise RecordError(
                f"{table.path}: t advances by {reader.mean:.6g} s a row, but --sample-time is "
                f"{given:.6g} s. Correct one of them (is t in seconds? --unit t=ms)"
            )
    return reader.clock(), reader.typical, reader.mean
