"""Counts and times of the marks of a run."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array, runs
from ..logs.quality.marks import MARKS

#: Most stretches that are kept of a mark; more are only counted.
KEPT = 1000


@dataclass
class Marked:
    """The rows with a mark.

    Attributes
    ----------
    rows : int
    stretches : list of (float, float)
        Times of the first and last row of each of the first stretches [s].
    count : int
        Number of stretches.
    """

    rows: int = 0
    stretches: list[tuple[float, float]] = field(default_factory=list)
    count: int = 0


@dataclass
class Quality:
    """Marks of the rows so far, by name."""

    marked: dict[str, Marked] = field(default_factory=dict)
    last: int = 0

    def add(self, t: Array, marks: NDArray[np.int64]) -> None:
        """Add the next rows."""
        for mark in MARKS:
            here = np.asarray(marks & mark.bit > 0)
            if not here.any():
                continue
            entry = self.marked.get(mark.name) or Marked()
            self.marked[mark.name] = entry
            entry.rows += int(here.sum())
            for start, end in runs(here):
                first, last = float(t[start]), float(t[end - 1])
                if start == 0 and self.last & mark.bit and entry.stretches:
                    if entry.count <= KEPT:
                        entry.stretches[-1] = (entry.stretches[-1][0], last)
                    continue
                entry.count += 1
                if entry.count <= KEPT:
                    entry.stretches.append((first, last))
        if len(marks):
            self.last = int(marks[-1])


def times_of(stretches: list[tuple[float, float]], count: int, named: int) -> str:
    """Return the times of the first stretches as text."""
    shown = [
        f"{start:.4g} s" if start == end else f"{start:.4g} to {end:.4g} s"
        for start, end in stretches[:named]
    ]
    if count > len(shown):
        shown.append(f"{count - len(shown)} more")
    return ", ".join(shown)
