"""Where a record does not fit: a bisection for events that one set of parameters cannot explain."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..smoothing.record import (
    Assumed,
    RecordSamples,
    SmoothedRecord,
    SmoothingModel,
    smooth_record,
)
from .fit import rank

#: Above this misfit, other starts are tried: a converged record has 0.001 to 0.05.
SUSPICIOUS_MISFIT = 0.1
#: Rows of the shortest part, and rows around the border of two parts that fit alone.
SHORTEST, BORDER = 512, 64
#: Fewest rows that anchor a record or a part of it.
LEAST_ANCHORS = 20


class EventSearch:
    """Search for the parts of a record that do not fit.

    Parameters
    ----------
    model : SmoothingModel
    samples : RecordSamples
    anchors : (rows,) ndarray of bool
    start : Assumed
        Where learning starts in each part.

    Attributes
    ----------
    best : SmoothedRecord, optional
        The part that fits best, at least a quarter of the record.
    """

    def __init__(
        self,
        model: SmoothingModel,
        samples: RecordSamples,
        anchors: NDArray[np.bool_],
        start: Assumed,
    ) -> None:
        self.model, self.samples, self.anchors, self.start = model, samples, anchors, start
        self.best: SmoothedRecord | None = None

    def events(self, first: int, last: int) -> list[tuple[int, int]]:
        """Return the rows (first, end) of the events between two rows."""
        record = self._learnt(first, last)
        if record is not None and record.misfit < SUSPICIOUS_MISFIT:
            if self.best is None or rank(record) < rank(self.best):
                self.best = record
            return []
        if last - first < 2 * SHORTEST:
            return [(first, last)]
        middle = (first + last) // 2
        inside = self.events(first, middle) + self.events(middle, last)
        return inside or [(middle - BORDER, middle + BORDER)]

    def _learnt(self, first: int, last: int) -> SmoothedRecord | None:
        """Learn from a part; None if nothing anchors it."""
        samples = self.samples
        long_enough = last - first >= 2 * self.model.rows_per_block
        if self.anchors[first:last].sum() < LEAST_ANCHORS or not long_enough:
            return None
        part = RecordSamples(
            samples.voltage[first:last],
            samples.current[first:last],
            samples.marks[first:last],
            samples.angle[first:last],
            samples.angle_std[first:last],
        )
        return smooth_record(self.model, part, self.start, learning=True)
