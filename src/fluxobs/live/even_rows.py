"""Rows of a stream at even times: what did not arrive is filled with rows that know nothing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array
from ..logs.clock import LONGEST_GAP, Clock, missing_steps
from ..logs.formats.table import Columns


class Spaced:
    """Puts rows at even times.

    Parameters
    ----------
    clock : Clock
        Of the first rows; its step and the rounding of its stamps are those of the stream.

    Attributes
    ----------
    lost : int
        Samples that are missing, by their stamps.
    """

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.lost = 0
        self._before: float | None = None  # time of the last row [s]

    def add(self, columns: Columns, t: Array) -> Columns:
        """The next rows, with their times "t" [s]; there may be more than came."""
        if len(t) == 0:
            return columns | {"t": t}
        h = self.clock.sample_time
        start = float(t[0]) - h if self._before is None else self._before
        self._before = float(t[-1])
        steps = np.diff(np.concatenate([[start], t]))
        missing = missing_steps(steps, h, self.clock.rounding)
        self.lost += int(missing.sum())
        return _filled(columns, start, t, np.minimum(missing, LONGEST_GAP))


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
