"""What a run keeps for its summary and picture; its size is bounded, however long the log."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..core.arrays import Array
from .columns import EstimateRows
from .truth import TruthSamples

#: Rows of the thinned-out log, and of the piece around the first valid row shown in full: as many
#: as a picture can show, and a few megabytes.
THIN_ROWS, DETAIL_ROWS = 4000, 3000


@dataclass
class Series:
    """Rows kept for the picture."""

    parts: list[dict[str, Array]] = field(default_factory=list)

    def add(self, rows: EstimateRows, keep: slice) -> None:
        columns = {**rows.columns, **rows.more}
        self.parts.append({name: np.array(v[keep], float) for name, v in columns.items()})

    def columns(self) -> dict[str, Array]:
        if not self.parts:
            return {}
        return {name: np.concatenate([part[name] for part in self.parts]) for name in self.parts[0]}


@dataclass
class Statistics:
    """Counts and sums over the rows of a run of `total` rows."""

    total: int
    rows: int = 0
    valid: int = 0
    start: float = 0.0
    first_valid: float | None = None  # time of the row [s]
    first_valid_row: int | None = None
    sums: dict[str, float] = field(default_factory=dict)  # of every column, over the valid rows
    settled: int = 0  # rows since the first valid one
    innovation: float = 0.0  # sum of squares over those
    scored: int = 0
    error: float = 0.0
    error_squared: float = 0.0
    error_max: float = 0.0
    found: dict[str, float] = field(default_factory=dict)  # every column of the last adapting row
    truth: TruthSamples | None = None
    thin: Series = field(default_factory=Series)
    detail: Series = field(default_factory=Series)

    def mean(self, name: str) -> float:
        """Mean of a column over the valid rows; there must be at least one."""
        return self.sums[name] / self.valid

    @property
    def rms_error(self) -> float:
        """Rms error of the position over the scored rows."""
        return float(np.sqrt(self.error_squared / self.scored))

    def add(self, rows: EstimateRows) -> None:
        """Take in the next rows."""
        t, valid = rows.columns["t"], rows.valid
        count = len(t)
        if self.rows == 0:
            self.start = float(t[0])
        if self.first_valid is None and valid.any():
            at = int(np.argmax(valid))
            self.first_valid, self.first_valid_row = float(t[at]), self.rows + at
        if self.first_valid_row is not None:
            self._add_settled(rows, self.first_valid_row, count)
        stride = max(1, self.total // THIN_ROWS)
        self.thin.add(rows, slice(-self.rows % stride, count, stride))
        self.valid += int(valid.sum())
        for name, values in rows.columns.items():
            self.sums[name] = self.sums.get(name, 0.0) + float(values[valid].sum())
        adapting = rows.more.get("adapting")
        if adapting is not None and adapting.any():
            last = int(np.flatnonzero(adapting)[-1])
            self.found = {name: float(values[last]) for name, values in rows.columns.items()}
        if rows.error is not None:
            known = rows.error[valid & np.isfinite(rows.error)]
            self.scored += len(known)
            self.error += float(known.sum())
            self.error_squared += float((known**2).sum())
            self.error_max = max(self.error_max, float(np.abs(known).max(initial=0.0)))
        if self.truth is not None and "raw" in rows.more:
            self.truth.add(rows)
        self.rows += count

    def _add_settled(self, rows: EstimateRows, first: int, count: int) -> None:
        """Add all rows from the first valid one on: a residual can itself make a row invalid."""
        since = max(0, first - self.rows)
        self.settled += count - since
        if rows.innovation is not None:
            self.innovation += float((rows.innovation[since:] ** 2).sum())
        low = max(0, first - DETAIL_ROWS // 3 - self.rows)
        high = first + 2 * DETAIL_ROWS // 3 - self.rows
        if high > 0:
            self.detail.add(rows, slice(low, min(high, count)))
