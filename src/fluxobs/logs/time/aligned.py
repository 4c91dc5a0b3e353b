"""Align rows as they arrive: assign to each current the voltage of the interval that ends there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...core.arrays import Array
from ...machines.model.frames import Frame, alphabeta_current, native_voltage, rotate, wrap
from ...machines.model.inverter import InverterError
from ..formats.table import Columns
from ..record import interval_rows


class Aligned(NamedTuple):
    """Aligned rows: time [s], current, mean voltage over the interval that ends at the row, truth.

    The truth is the scaled channel, e.g. an electrical or mechanical angle [rad] or a position [m].
    The marks, if any, are those of :mod:`fluxobs.logs.quality`.
    """

    t: Array
    current: Array
    voltage: Array
    truth: Array | None
    marks: NDArray[np.int64] | None = None


def between(piece: Aligned, first: int, last: int) -> Aligned:
    """Return rows first … last - 1 of aligned rows."""
    truth = None if piece.truth is None else piece.truth[first:last]
    marks = None if piece.marks is None else piece.marks[first:last]
    t, current, voltage = (column[first:last] for column in piece[:3])
    return Aligned(t, current, voltage, truth, marks)


def joined(pieces: Sequence[Aligned]) -> Aligned:
    """Join consecutive aligned rows."""
    t, current, voltage = (
        np.concatenate(column) for column in zip(*(piece[:3] for piece in pieces), strict=True)
    )
    truth = [piece.truth for piece in pieces if piece.truth is not None]
    marks = [piece.marks for piece in pieces if piece.marks is not None]
    return Aligned(
        t,
        current,
        voltage,
        np.concatenate(truth) if truth else None,
        np.concatenate(marks) if marks else None,
    )


def less_lost(rows: Aligned, inverter: InverterError, before: Array) -> Aligned:
    """Subtract inverter losses; `before`, shape (1, 2), is the current before the first row."""
    currents = np.concatenate([before, rows.current])
    return rows._replace(voltage=rows.voltage - inverter.lost(currents[:-1], currents[1:]))


# (time, current, middle, truth); in frame dq, `middle` is the angle in the middle of the interval
# that ends at the row.
_Piece = tuple[Array, Array, Array | None, Array | None]


def _join(first: _Piece | None, second: _Piece) -> _Piece:
    if first is None or len(first[0]) == 0:
        return second
    (t0, i0, m0, h0), (t1, i1, m1, h1) = first, second
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


def _align(piece: _Piece, source: Array, lag: float, first: int, start: int) -> Aligned:
    t, current, middle, truth = piece
    voltage = interval_rows(source, lag, first, first + len(t), start)
    return Aligned(t, current, voltage if middle is None else rotate(voltage, middle), truth)


class Aligning:
    """Align the rows of a log in batches of any size; the size does not change the values.

    Parameters
    ----------
    frame, current_frame : Frame
    lag : float
        In samples.
    inverter : InverterError, optional
        Error that is subtracted from the commanded voltage.
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
        self._source = np.empty((0, 2))  # Recorded voltages of rows _oldest … _row - 1.
        self._oldest = self._emitted = self._row = first
        self._waiting: _Piece | None = None  # Rows whose voltage may not have arrived.
        self._angle = np.nan  # Angle of the last row, if the frame is dq.
        self._before: Array | None = None  # Current of the last yielded row.

    def add(self, t: Array, channels: Columns, truth: Array | None) -> Iterator[Aligned]:
        """Add rows (times [s], channels in SI, scaled truth); yield the rows that are complete."""
        middle = None
        if self.frame == "dq":
            angle = np.r_[self._angle, channels["theta_e"]]
            middle = angle[:-1] + wrap(np.diff(angle)) / 2
            self._angle = float(angle[-1])
        self._source = np.concatenate([self._source, native_voltage(self.frame, channels)])
        self._row += len(t)
        current = alphabeta_current(self.current_frame, channels)
        self._waiting = _join(self._waiting, (t, current, middle, truth))
        # Row k needs voltages up to row ceil(k - 1 + lag).
        ready = min(self._row, self._row - int(np.ceil(self.lag - 1)))
        if ready > self._emitted:
            complete, self._waiting = _split(self._waiting, ready - self._emitted)
            yield self._aligned(complete)
            self._emitted = ready
        oldest = min(max(self._oldest, self._emitted - 1 + int(np.floor(self.lag))), self._row)
        self._source, self._oldest = self._source[oldest - self._oldest :], oldest

    def end(self) -> Iterator[Aligned]:
        """Yield the last rows, for which no voltage arrived."""
        if self._waiting is not None and self._row > self._emitted:
            yield self._aligned(self._waiting)

    def _aligned(self, piece: _Piece) -> Aligned:
        rows = _align(piece, self._source, self.lag, self._emitted, self._oldest)
        if self.inverter is None:
            return rows
        before = rows.current[:1] if self._before is None else self._before
        self._before = rows.current[-1:]
        return less_lost(rows, self.inverter, before)
