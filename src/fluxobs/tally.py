"""What is remembered of a run for its summary and picture: bounded, however long the log."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .logs import Aligned
from .observers import AdaptiveEstimate, Estimate

Array = NDArray[np.float64]

#: Rows of the thinned-out whole, and of the piece shown in full around the first valid row.
THIN_ROWS, DETAIL_ROWS = 4000, 3000

#: What the adaptive observer finds of machine and inverter.
FOUND = (
    "resistance",
    "resistance_std",
    "inverter_voltage",
    "inverter_voltage_std",
    "psi_f_std",
)


@dataclass
class Series:
    """Rows kept for the picture."""

    parts: list[dict[str, Array]] = field(default_factory=list)

    def add(self, rows: Aligned, estimate: Estimate, error: Array | None, keep: slice) -> None:
        part = {
            "t": rows.t[keep],
            "flux_alpha": estimate.flux[keep, 0],
            "flux_beta": estimate.flux[keep, 1],
            "psi_f": estimate.psi_f[keep],
            "theta_e": estimate.theta_e[keep],
            "theta_e_std": estimate.theta_e_std[keep],
            "speed_e": estimate.speed_e[keep],
            "drift_alpha": estimate.drift[keep, 0],
            "drift_beta": estimate.drift[keep, 1],
            "valid": estimate.valid[keep].astype(float),
        }
        if isinstance(estimate, AdaptiveEstimate):
            part |= {name: getattr(estimate, name)[keep] for name in FOUND}
            part["adapting"] = estimate.adapting[keep].astype(float)
        if error is not None and rows.truth is not None:
            part |= {"theta_e_error": error[keep], "truth": rows.truth[keep]}
        self.parts.append({name: values.copy() for name, values in part.items()})

    def columns(self) -> dict[str, Array]:
        if not self.parts:
            return {}
        return {name: np.concatenate([part[name] for part in self.parts]) for name in self.parts[0]}


@dataclass
class Tally:
    """Counts and sums over the rows of a run."""

    total: int
    rows: int = 0
    valid: int = 0
    start: float = 0.0
    first_valid: float | None = None  # time of the row [s]
    first_valid_row: int | None = None
    drift: Array = field(default_factory=lambda: np.zeros(2))
    psi: float = 0.0
    settled: int = 0  # rows since the first valid one
    innovation: float = 0.0  # sum of squares over these
    scored: int = 0
    error: float = 0.0
    error_squared: float = 0.0
    error_max: float = 0.0
    found: dict[str, float] = field(default_factory=dict)  # of the last adapting row
    thin: Series = field(default_factory=Series)
    detail: Series = field(default_factory=Series)

    def add(self, rows: Aligned, estimate: Estimate, error: Array | None) -> None:
        """Takes the next rows in."""
        count, valid = len(rows.t), estimate.valid
        if self.rows == 0:
            self.start = float(rows.t[0])
        if self.first_valid is None and valid.any():
            at = int(np.argmax(valid))
            self.first_valid, self.first_valid_row = float(rows.t[at]), self.rows + at
        if self.first_valid_row is not None:
            # From then on all rows: those that are not valid are so because of their residual.
            since = max(0, self.first_valid_row - self.rows)
            self.settled += count - since
            self.innovation += float((estimate.innovation[since:] ** 2).sum())
            low = max(0, self.first_valid_row - DETAIL_ROWS // 3 - self.rows)
            high = self.first_valid_row + 2 * DETAIL_ROWS // 3 - self.rows
            if high > 0:
                self.detail.add(rows, estimate, error, slice(low, min(high, count)))
        stride = max(1, self.total // THIN_ROWS)
        self.thin.add(rows, estimate, error, slice(-self.rows % stride, count, stride))
        self.valid += int(valid.sum())
        self.drift = self.drift + estimate.drift[valid].sum(axis=0)
        self.psi += float(estimate.psi_f[valid].sum())
        if isinstance(estimate, AdaptiveEstimate) and estimate.adapting.any():
            last = int(np.flatnonzero(estimate.adapting)[-1])
            names = (*FOUND, "psi_f")
            self.found = {name: float(getattr(estimate, name)[last]) for name in names}
        if error is not None:
            known = error[valid & np.isfinite(error)]
            self.scored += len(known)
            self.error += float(known.sum())
            self.error_squared += float((known**2).sum())
            self.error_max = max(self.error_max, float(np.abs(known).max(initial=0.0)))
        self.rows += count
