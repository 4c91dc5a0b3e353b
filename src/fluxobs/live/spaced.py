"""Rows of a stream at even times: what did not arrive is filled with rows that know nothing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..logs.clock import LONGEST_GAP, Clock, missing_steps
from ..logs.formats.table import Columns

Array = NDArray[np.float64]


class Spaced:
    """Puts rows at even times.

    Parameters
    ----------
    clock : Clock
        Of the first rows; its step and the rounding of its stamps are those of the stream.
    time : str, optional
        Column of the stamps.
    scale, offset : float
        What turns it into seconds.

    Attributes
    ----------
    lost : int
        Samples that are missing, by their stamps.
    restarts : int
        How often time went back: the sender began anew.
    twice : int
        Rows with the stamp of the row before, which are left out.
    """

    def __init__(self, clock: Clock, time: str | None, scale: float, offset: float) -> None:
        self.clock, self.time, self.scale, self.offset = clock, time, scale, offset
        self.lost = self.restarts = self.twice = 0
        self._rows = 0
        self._before: float | None = None  # stamp of the last row, as it came [s]
        self._ahead = 0.0  # what wraps and restarts have added to the stamps [s]

    def add(self, part: Columns) -> Columns:
        """The next rows, "t" in seconds among them; there may be more or fewer than came."""
        h = self.clock.sample_time
        count = len(next(iter(part.values())))
        if self.time is None:
            self._rows += count
            rows = np.arange(self._rows - count, self._rows)
            return part | {"t": np.asarray(self.clock.t0 + h * rows)}
        stamp = part[self.time] * self.scale + self.offset
        known = np.isfinite(stamp)
        if not known.all():  # damaged: a gap, as if they had not come
            part = {name: values[known] for name, values in part.items()}
            stamp = stamp[known]
        if len(stamp) == 0:
            return part | {"t": stamp}
        first = stamp[0] - h if self._before is None else self._before
        raw = np.diff(np.concatenate([[first], stamp]))
        if not self.clock.rounding and not raw.all():  # sent twice
            once = raw != 0
            self.twice += int((~once).sum())
            part, stamp, raw = {name: v[once] for name, v in part.items()}, stamp[once], raw[once]
            if len(stamp) == 0:
                return part | {"t": stamp}
        steps = self._forward(raw)
        start = first + self._ahead
        ahead = np.cumsum(np.concatenate([[self._ahead], steps - raw]))[1:]
        self._before, self._ahead = float(stamp[-1]), float(ahead[-1])
        t = stamp + ahead
        missing = missing_steps(steps, h, self.clock.rounding)
        self.lost += int(missing.sum())
        return _filled(part, start, t, np.minimum(missing, LONGEST_GAP))

    def _forward(self, steps: Array) -> Array:
        """Steps without those that go back: over a wrap of the counter, or a sender's restart."""
        h, wrap = self.clock.sample_time, self.clock.wrap
        back = steps < 0
        if not back.any():
            return steps
        over = steps + wrap
        wrapped = back & (over > 0) & (wrap > 0)
        self.restarts += int((back & ~wrapped).sum())
        return np.where(wrapped, over, np.where(back, 2 * h, steps))


def _filled(part: Columns, start: float, t: Array, missing: NDArray[np.int64]) -> Columns:
    """Rows of nothing where some are missing; `start` is the time of the row before."""
    if not missing.any():
        return part | {"t": t}
    at = np.arange(len(t)) + np.cumsum(missing)
    rows = int(at[-1]) + 1
    out = {}
    for name, values in part.items():
        whole = np.full(rows, np.nan)
        whole[at] = values
        out[name] = whole
    known = np.concatenate([[-1], at])
    out["t"] = np.interp(np.arange(rows), known, np.concatenate([[start], t]))
    return out
