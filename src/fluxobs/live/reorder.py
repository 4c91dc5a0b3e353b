"""Rows in the order of their stamps: a connection repeats, delays and damages some."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..core.arrays import Array
from ..logs.clock import Clock, longest_step
from .rows import StreamRows, joined

#: A stamp that is farther ahead [s] tells nothing: the sender began anew.
_FARTHEST = 86400.0
#: Stamps beyond are no times [s].
_NO_TIME = 1e12


class Ordered(NamedTuple):
    """Rows in order.

    Attributes
    ----------
    part : StreamRows
        The rows, as they came.
    t : (rows,) ndarray
        Their times, which increase [s].
    moved : (rows,) ndarray
        What restarts of the sender have added to the stamps [s].
    """

    part: StreamRows
    t: Array
    moved: Array


class Order:
    """Puts rows in order.

    A row that does not follow the one before it is judged by the next one. If that follows the
    row in question, some samples are missing, or the sender began anew. If it follows the row
    before, the row in question came late, or its stamp is damaged: it is left out.

    Parameters
    ----------
    clock : Clock
        Of the first rows; its step, the rounding of its stamps and their wrap are the stream's.
    time : str, optional
        Column of the stamps; without it the rows count the time.
    scale, offset : float
        What turns stamps into seconds.

    Attributes
    ----------
    restarts : int
        How often the sender began anew.
    left_out : int
        Rows that came twice or late, or without a time.
    """

    def __init__(self, clock: Clock, time: str | None, scale: float, offset: float) -> None:
        self.clock, self.time, self.scale, self.offset = clock, time, scale, offset
        self.restarts = self.left_out = 0
        self._rows = 0
        self._held: StreamRows | None = None  # the row in question
        self._before: float | None = None  # stamp of the last row, as it came [s]
        self._ahead = self._moved = 0.0  # what wraps and restarts, and these alone, have added [s]

    def add(self, part: StreamRows) -> Ordered:
        """The next rows."""
        if self._held is not None:
            part, self._held = joined(self._held, part), None
        if self.time is None:
            self._rows += part.rows
            rows = np.arange(self._rows - part.rows, self._rows)
            t = np.asarray(self.clock.t0 + self.clock.sample_time * rows)
            return Ordered(part, t, np.zeros(part.rows))
        stamp = part.columns[self.time] * self.scale + self.offset
        known = np.abs(stamp) < _NO_TIME
        if not known.all():
            self.left_out += int((~known).sum())
            part, stamp = part.at(known), stamp[known]
        if self._before is not None and len(stamp):
            steps = np.diff(np.concatenate([[self._before], stamp]))
            on = steps >= 0 if self.clock.rounding else steps > 0
            if (on & (steps <= self._longest)).all():
                self._before = float(stamp[-1])
                return Ordered(part, stamp + self._ahead, np.full(len(stamp), self._moved))
        return self._judged(part, stamp)

    def end(self) -> Ordered:
        """The row that no other one judges any more: it is there, if time goes on to it."""
        held, self._held = self._held, None
        none = np.zeros(0)
        if held is None:
            return Ordered(StreamRows({}, b""), none, none)
        stamp = float(held.columns[str(self.time)][0]) * self.scale + self.offset
        if self._before is not None and self._step(stamp, self._before) < 0:
            self.left_out += 1
            return Ordered(held.at(np.zeros(1, dtype=bool)), none, none)
        self._accept(stamp)
        return Ordered(held, np.array([stamp + self._ahead]), np.array([self._moved]))

    @property
    def _longest(self) -> float:
        return longest_step(self.clock.sample_time, self.clock.rounding)

    def _step(self, now: float, before: float) -> float:
        """The step between two stamps [s], the shorter way around a counter that wraps."""
        step, wrap = now - before, self.clock.wrap
        if wrap > 0 and abs(step) > wrap / 2:
            step += wrap if step < 0 else -wrap
        return step

    def _judged(self, part: StreamRows, stamp: Array) -> Ordered:
        """Rows one by one."""
        rows: list[int] = []
        added: list[tuple[float, float]] = []
        stamps = [float(one) for one in stamp]
        repeat = self.clock.rounding > 0
        held: int | None = None
        k = 0

        def accept(row: int) -> None:
            self._accept(stamps[row])
            rows.append(row)
            added.append((self._ahead, self._moved))

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
            self._held = part.at(np.arange(len(stamps)) == held)
        kept = np.zeros(len(stamps), dtype=bool)
        for row in rows:
            kept[row] = True
        ahead = np.array([one for one, _ in added], dtype=float)
        moved = np.array([one for _, one in added], dtype=float)
        return Ordered(part if kept.all() else part.at(kept), stamp[kept] + ahead, moved)

    def _accept(self, stamp: float) -> None:
        """Go on to a stamp."""
        before, self._before = self._before, stamp
        if before is None:
            return
        step = self._step(stamp, before)
        if step < 0 or step > _FARTHEST:
            self.restarts += 1
            goes = 2 * self.clock.sample_time
            self._moved += goes - step
            self._ahead += goes - (stamp - before)
        else:
            self._ahead += step - (stamp - before)
