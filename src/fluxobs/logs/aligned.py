"""Currents, and the voltages that acted until then: rows as they come, aligned by their lag."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..core.arrays import Array
from ..machines.model.frames import Frame, alphabeta_current, native_voltage, rotate, wrap
from ..machines.model.inverter import InverterError
from .formats.table import Columns
from .record import interval_rows


class Aligned(NamedTuple):
    """Rows of a log: time [s], current now, mean voltage over the interval ending now, and the
    scaled truth channel: an electrical or mechanical angle [rad], or a position [m].
    """

    t: Array
    current: Array
    voltage: Array
    truth: Array | None


def between(part: Aligned, first: int, last: int) -> Aligned:
    """Rows first … last - 1 of a piece."""
    truth = None if part.truth is None else part.truth[first:last]
    t, current, voltage = (column[first:last] for column in part[:3])
    return Aligned(t, current, voltage, truth)


def joined(parts: Sequence[Aligned]) -> Aligned:
    """Join pieces into one."""
    t, current, voltage = (
        np.concatenate(column) for column in zip(*(part[:3] for part in parts), strict=True)
    )
    truth = [part.truth for part in parts if part.truth is not None]
    return Aligned(t, current, voltage, np.concatenate(truth) if truth else None)


def less_lost(part: Aligned, inverter: InverterError, before: Array) -> Aligned:
    """Rows less what the inverter loses; `before` is the current of the row before them, (1, 2)."""
    currents = np.concatenate([before, part.current])
    return part._replace(voltage=part.voltage - inverter.lost(currents[:-1], currents[1:]))


# Time, current, angle in the middle of the interval ending now (frame dq), truth.
_Piece = tuple[Array, Array, Array | None, Array | None]


def _join(one: _Piece | None, other: _Piece) -> _Piece:
    if one is None or len(one[0]) == 0:
        return other
    (t0, i0, m0, h0), (t1, i1, m1, h1) = one, other
    return (
        np.concatenate([t0, t1]),
        np.concatenate([i0, i1]),
        None if m0 is None or m1 is None else np.concatenate([m0, m1]),
        None if h0 is None or h1 is None else np.concatenate([h0, h1]),
    )


def _split(piece: _Piece, at: int) -> tuple[_Piece, _Piece]:
    t, i, m, h = piece
    return (
        (t[:at], i[:at], None if m is None else m[:at], None if h is None else h[:at]),
        (t[at:], i[at:], None if m is None else m[at:], None if h is None else h[at:]),
    )


def _align(piece: _Piece, source: Array, lag: float, first: int, held: int) -> Aligned:
    t, current, middle, truth = piece
    voltage = interval_rows(source, lag, first, first + len(t), held)
    return Aligned(t, current, voltage if middle is None else rotate(voltage, middle), truth)


class Aligning:
    """Rows of a log in order, of any number at once; the number changes none of the values.

    Parameters
    ----------
    frame, current_frame : Frame
    lag : float
        In samples.
    inverter : InverterError, optional
        Subtracted from the commanded voltage.
    first : int
        Number of the first row.
    """

    def __init__(
        self,
        frame: Frame,
        current_frame: Frame,
        lag: float,
        inverter: InverterError | None,
        first: int = 0,
    ) -> None:
        self.frame, self.current_frame, self.lag, self.inverter = (
            frame,
            current_frame,
            lag,
            inverter,
        )
        self._source = np.empty((0, 2))  # voltages as recorded, rows held … row - 1
        self._held = self._emitted = self._row = first
        self._waiting: _Piece | None = None  # rows whose voltage may not have come yet
        self._angle = np.nan  # of the last row, if the frame is dq
        self._before: Array | None = None  # current of the last row that was yielded

    def add(self, t: Array, channels: Columns, truth: Array | None) -> Iterator[Aligned]:
        """Take the next rows: times [s], channels in SI, scaled truth; yield what is complete."""
        middle = None
        if self.frame == "dq":
            angle = np.r_[self._angle, channels["theta_e"]]
            middle = angle[:-1] + wrap(np.diff(angle)) / 2
            self._angle = float(angle[-1])
        self._source = np.concatenate([self._source, native_voltage(self.frame, channels)])
        self._row += len(t)
        current = alphabeta_current(self.current_frame, channels)
        self._waiting = _join(self._waiting, (t, current, middle, truth))
        # Row k needs the voltage row at or above k - 1 + lag.
        ready = min(self._row, self._row - int(np.ceil(self.lag - 1)))
        if ready > self._emitted:
            done, self._waiting = _split(self._waiting, ready - self._emitted)
            yield self._made(done)
            self._emitted = ready
        keep = min(max(self._held, self._emitted - 1 + int(np.floor(self.lag))), self._row)
        self._source, self._held = self._source[keep - self._held :], keep

    def end(self) -> Iterator[Aligned]:
        """Yield the rows whose voltage never came."""
        if self._waiting is not None and self._row > self._emitted:
            yield self._made(self._waiting)

    def _made(self, piece: _Piece) -> Aligned:
        part = _align(piece, self._source, self.lag, self._emitted, self._held)
        if self.inverter is None:
            return part
        before = part.current[:1] if self._before is None else self._before
        self._before = part.current[-1:]
        return less_lost(part, self.inverter, before)
