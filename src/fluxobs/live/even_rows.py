"""Evenly spaced rows of a stream: missing rows are filled with NaN."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array
from ..logs.formats.table import Columns
from ..logs.time.clock import LONGEST_GAP, Clock, missing_steps


class Spaced:
    """Evenly spaced rows.

    Parameters
    ----------
    clock : Clock
        Clock of the first rows, whose step and rounding apply to the whole stream.

    Attributes
    ----------
    lost : int
        Samples missing according to the time stamps.
    """

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.lost = 0
        self._before: float | None = None  # time of the last row [s]

    def add(self, columns: Columns, t: Array) -> Columns:
        """Return the next rows, with rows of NaN for missing samples, and their times "t" [s]."""
        if len(t) == 0:
            return columns | {"t": t}
        h = self.clock.sample_time
        start = float(t[0]) - h if self._before is None else self._before
        self._before = float(t[-1])
        steps = np.diff(np.concatenate([[start], t]))
        missing = missing_steps(steps, h, self.clock.rounding)
        self.lost += int(missing.sum())
        return _fill_missing(columns, start, t, np.minimum(missing, LONGEST_GAP))


def _fill_missing(columns: Columns, start: float, t: Array, missing: NDArray[np.int64]) -> Columns:
    """Insert rows of NaN where samples are missing; `start` is the time of the previous row."""
    if not missing.any():
        return columns | {"t": t}
    at = np.arange(len(t)) + np.cumsum(missing)
    rows = int(at[-1]) + 1
    filled = {}
    for name, values in columns.items():
        column = np.full(rows, np.nan)
        column[at] = values
        filled[name] = column
    anchors = np.concatenate([[-1], at])
    filled["t"] = np.interp(np.arange(rows), anchors, np.concatenate([[start], t]))
    return filled
