"""Data for the summary and picture of a run; the size of the data does not grow with the log."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..core.arrays import Array
from ..observers.adaptive import REASONS
from ..smoothing.estimate import VALID_STD
from .columns import EstimateRows
from .quality import Quality
from .truth import TruthSamples

#: Number of rows of the thinned-out log, and of the window around the first valid row, which is
#: shown in full. A picture cannot resolve more rows; these fit into a few megabytes.
THIN_ROWS, DETAIL_ROWS = 4000, 3000


@dataclass
class Series:
    """Rows for the picture."""

    batches: list[dict[str, Array]] = field(default_factory=list)

    def add(self, rows: EstimateRows, keep: slice) -> None:
        columns = {**rows.columns, **rows.more}
        self.batches.append(
            {name: np.array(values[keep], float) for name, values in columns.items()}
        )

    def columns(self) -> dict[str, Array]:
        if not self.batches:
            return {}
        return {
            name: np.concatenate([batch[name] for batch in self.batches])
            for name in self.batches[0]
        }


def reasons_of(rows: EstimateRows) -> dict[str, int]:
    """Return why rows have no valid position, with their number."""
    if "valid_reason" in rows.columns:  # an observer that names its reasons
        numbers = rows.columns["valid_reason"]
        return {REASONS[n]: int((numbers == n).sum()) for n in range(1, len(REASONS))}
    std = rows.columns.get("theta_e_std")
    if std is None or "unexplained" not in rows.more:
        return {}
    lost, unexplained = ~rows.valid, rows.more["unexplained"] > 0
    limit = f"σ above {np.degrees(VALID_STD):.0f}°"
    return {
        "contradicted by the model": int((lost & unexplained).sum()),
        limit: int((lost & ~unexplained & ~(std < VALID_STD)).sum()),
        "less than a turn between uncertain rows": int(
            (lost & ~unexplained & (std < VALID_STD)).sum()
        ),
    }


@dataclass
class Statistics:
    """Counts and sums over the rows of a run of `total` rows."""

    total: int
    rows: int = 0
    valid: int = 0
    start: float = 0.0
    first_valid: float | None = None  # time of the row [s]
    first_valid_row: int | None = None
    sums: dict[str, float] = field(default_factory=dict)  # sum of each column over the valid rows
    settled: int = 0  # rows since the first valid row
    innovation: float = 0.0  # sum of squares over the settled rows
    scored: int = 0
    error: float = 0.0
    error_squared: float = 0.0
    error_max: float = 0.0
    # Value of each column in the last adapting row.
    last_adapting: dict[str, float] = field(default_factory=dict)
    truth: TruthSamples | None = None
    quality: Quality = field(default_factory=Quality)
    # Rows without a valid position, by the observer's reason.
    not_valid: dict[str, int] = field(default_factory=dict)
    thin: Series = field(default_factory=Series)
    detail: Series = field(default_factory=Series)

    def mean(self, name: str) -> float:
        """Return the mean of a column over the valid rows; at least one row must be valid."""
        return self.sums[name] / self.valid

    @property
    def rms_error(self) -> float:
        """Rms position error over the scored rows."""
        return float(np.sqrt(self.error_squared / self.scored))

    def add(self, rows: EstimateRows) -> None:
        """Add the next rows."""
        t, valid = rows.columns["t"], rows.valid
        count = len(t)
        if self.rows == 0:
            self.start = float(t[0])
        if self.first_valid is None and valid.any():
            index = int(np.argmax(valid))
            self.first_valid, self.first_valid_row = float(t[index]), self.rows + index
        if self.first_valid_row is not None:
            self._add_settled(rows, self.first_valid_row, count)
        stride = max(1, self.total // THIN_ROWS)
        self.thin.add(rows, slice(-self.rows % stride, count, stride))
        self.valid += int(valid.sum())
        for name, values in rows.columns.items():
            self.sums[name] = self.sums.get(name, 0.0) + float(values[valid].sum())
        if "quality" in rows.columns:
            self.quality.add(t, rows.columns["quality"])
        for reason, count_of in reasons_of(rows).items():
            if count_of:
                self.not_valid[reason] = self.not_valid.get(reason, 0) + count_of
        adapting = rows.more.get("adapting")
        if adapting is not None and adapting.any():
            row = int(np.flatnonzero(adapting)[-1])
            self.last_adapting = {name: float(values[row]) for name, values in rows.columns.items()}
        if rows.error is not None:
            errors = rows.error[valid & np.isfinite(rows.error)]
            self.scored += len(errors)
            self.error += float(errors.sum())
            self.error_squared += float((errors**2).sum())
            self.error_max = max(self.error_max, float(np.abs(errors).max(initial=0.0)))
        if self.truth is not None and "raw" in rows.more:
            self.truth.add(rows)
        self.rows += count

    def _add_settled(self, rows: EstimateRows, first: int, count: int) -> None:
        """Add the first valid row and all later rows, valid or not.

        A large innovation alone can make a row invalid.
        """
        since = max(0, first - self.rows)
        self.settled += count - since
        if rows.innovation is not None:
            self.innovation += float((rows.innovation[since:] ** 2).sum())
        start = max(0, first - DETAIL_ROWS // 3 - self.rows)
        end = first + 2 * DETAIL_ROWS // 3 - self.rows
        if end > 0:
            self.detail.add(rows, slice(start, min(end, count)))
