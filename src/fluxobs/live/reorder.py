"""Sort rows by their time stamps, since a connection repeats, delays and damages some rows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..core.arrays import Array
from ..logs.time.clock import Clock, longest_step
from .rows import StreamRows, joined

#: A stamp farther ahead than this [s] means that the sender restarted.
_FARTHEST = 86400.0
#: A stamp beyond this [s] is not a time.
_NO_TIME = 1e12


class Ordered(NamedTuple):
    """Rows in order.

    Attributes
    ----------
    received : StreamRows
        The rows as received.
    t : (rows,) ndarray
        Times of the rows [s], increasing.
    moved : (rows,) ndarray
        Offsets added to the stamps because the sender restarted [s].
    """

    received: StreamRows
    t: Array
    moved: Array


class Order:
    """Filter that puts rows in the order of their time stamps.

    A row that does not follow its predecessor is held back until the next row arrives. If the
    next row follows the held row, samples are missing or the sender restarted. If the next row
    follows the predecessor, the held row is late or has a damaged stamp, and is left out.

    Parameters
    ----------
    clock : Clock
        Clock of the first rows, whose step, rounding and wrap apply to the whole stream.
    time : str, optional
        Column of the stamps. Without this column, rows are counted.
    scale, offset : float
        Conversion of the stamps to seconds.

    Attributes
    ----------
    restarts : int
        Restarts of the sender.
    left_out : int
        Rows left out: repeated, late, or without a time.
    """

    def __init__(self, clock: Clock, time: str | None, scale: float, offset: float) -> None:
        self.clock, self.time, self.scale, self.offset = clock, time, scale, offset
        self.restarts = self.left_out = 0
        self._rows = 0
        self._held: StreamRows | None = None  # at most one row, until the next row arrives
        self._before: float | None = None  # stamp of the last row as received [s]
        # Offsets added to the stamps [s]: for wraps and restarts, and for restarts alone.
        self._ahead = self._moved = 0.0

    def add(self, rows: StreamRows) -> Ordered:
        """Add the next rows; return those whose order is decided."""
        if self._held is not None:
            rows, self._held = joined(self._held, rows), None
        if self.time is None:
            self._rows += rows.rows
            numbers = np.arange(self._rows - rows.rows, self._rows)
            t = np.asarray(self.clock.t0 + self.clock.sample_time * numbers)
            return Ordered(rows, t, np.zeros(rows.rows))
        stamp = rows.columns[self.time] * self.scale + self.offset
        timed = np.abs(stamp) < _NO_TIME
        if not timed.all():
            self.left_out += int((~timed).sum())
            rows, stamp = rows.at(timed), stamp[timed]
        if self._before is not None and len(stamp):
            steps = np.diff(np.concatenate([[self._before], stamp]))
            forward = steps >= 0 if self.clock.rounding else steps > 0
            if (forward & (steps <= self._longest)).all():
                self._before = float(stamp[-1])
                return Ordered(rows, stamp + self._ahead, np.full(len(stamp), self._moved))
        return self._judge_rows(rows, stamp)

    def end(self) -> Ordered:
        """Return the held row at the end of the stream, unless its time goes back."""
        held, self._held = self._held, None
        empty = np.zeros(0)
        if held is None:
            return Ordered(StreamRows({}, b""), empty, empty)
        stamp = float(held.columns[str(self.time)][0]) * self.scale + self.offset
        if self._before is not None and self._step(stamp, self._before) < 0:
            self.left_out += 1
            return Ordered(held.at(np.zeros(1, dtype=bool)), empty, empty)
        self._accept(stamp)
        return Ordered(held, np.array([stamp + self._ahead]), np.array([self._moved]))

    @property
    def _longest(self) -> float:
        return longest_step(self.clock.sample_time, self.clock.rounding)

    def _step(self, now: float, before: float) -> float:
        """Return the step between two stamps [s], the shorter way around a counter that wraps."""
        step, wrap = now - before, self.clock.wrap
        if wrap > 0 and abs(step) > wrap / 2:
            step += wrap if step < 0 else -wrap
        return step

    def _judge_rows(self, rows: StreamRows, stamp: Array) -> Ordered:
        """Decide for each row whether it is in order; hold back the last row if undecided."""
        accepted: list[int] = []
        offsets: list[tuple[float, float]] = []
        stamps = [float(seconds) for seconds in stamp]
        repeat = self.clock.rounding > 0
        held: int | None = None
        k = 0

        def accept(row: int) -> None:
            self._accept(stamps[row])
            accepted.append(row)
            offsets.append((self._ahead, self._moved))

        while k < len(stamps):
            now, before = stamps[k], self._before
            since = None if before is None else self._step(now, before)
            if held is None:
                if since is not None and (since > 0 or repeat) and 0 <= since <= self._longest:
                    accept(k)
                elif since == 0:
                    self.left_out += 1
                else:
                    held = k
                k += 1
                continue
            onward = self._step(now, stamps[held])
            went_back = before is not None and self._step(stamps[held], before) < 0
            if onward == 0 and not repeat:
                self.left_out += 1
                k += 1
            elif onward < 0 or (went_back and since is not None and since > 0):
                self.left_out += 1
                held = None
            else:
                accept(held)
                held = None
        if held is not None:
            self._held = rows.at(np.arange(len(stamps)) == held)
        in_order = np.zeros(len(stamps), dtype=bool)
        for row in accepted:
            in_order[row] = True
        ahead = np.array([seconds for seconds, _ in offsets], dtype=float)
        moved = np.array([seconds for _, seconds in offsets], dtype=float)
        ordered = rows if in_order.all() else rows.at(in_order)
        return Ordered(ordered, stamp[in_order] + ahead, moved)

    def _accept(self, stamp: float) -> None:
        """Advance to a stamp; count a restart if the stamp goes back or far ahead."""
        before, self._before = self._before, stamp
        if before is None:
            return
        step = self._step(stamp, before)
        if step < 0 or step > _FARTHEST:
            self.restarts += 1
            resumed = 2 * self.clock.sample_time  # assume that one sample is lost
            self._moved += resumed - step
            self._ahead += resumed - (stamp - before)
        else:
            self._ahead += step - (stamp - before)
