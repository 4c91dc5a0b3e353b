"""The error budget of a run: which assumption contributes how much to the position's error."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array, runs
from ..smoothing.assumptions import ITEMS
from ..smoothing.record import SHARES

#: Stretches at the borders of two windows are one if they are closer than this [s].
MERGED = 0.01
#: Names of the items: those of ITEMS, then what no assumption explains.
NAMES: tuple[str, ...] = (*(item.name for item in ITEMS), "smoother", "noise")
#: Columns of the shares of assumptions that belong to each item.
_GROUPS = [
    *([SHARES.index(name) for name in item.assumptions] for item in ITEMS),
    *([SHARES.index(name)] for name in ("smoother", "noise")),
]


def item_shares(shares: Array) -> Array:
    """Return variances by item from those by assumption; (n, len(SHARES)) → (n, len(NAMES)).

    Correlations count for both assumptions by half, so a share can be negative; such a share
    counts as zero.
    """
    columns = [shares[:, group].sum(axis=1) for group in _GROUPS]
    return np.asarray(np.maximum(np.stack(columns, axis=1), 0.0))


@dataclass(frozen=True)
class Contribution:
    """Contribution of an item to the standard deviation of the position.

    Attributes
    ----------
    name : str
    std : float
        Rms over the valid rows [rad].
    remedy : str
        What makes it smaller; empty if nothing can be measured.
    """

    name: str
    std: float
    remedy: str


@dataclass
class Budget:
    """Error budget of the position, collected over a run.

    Attributes
    ----------
    rows : float
        Number of valid rows.
    variances : (items,) ndarray
        Sum over the valid rows of each item's variance [rad^2].
    t, series : lists of ndarray
        Times [s] and variances of the items [rad^2], thinned out for the picture.
    misfit : float
        Mean square of the normalised innovations of the smoother; NaN if it did not run.
    stretches : list of (float, float)
        Start and end of each stretch that does not fit its surroundings [s].
    contradiction : str
        Item of the assumption that the log contradicts, or an empty string.
    """

    rows: float = 0.0
    variances: Array = field(default_factory=lambda: np.zeros(len(NAMES)))
    t: list[Array] = field(default_factory=list)
    series: list[Array] = field(default_factory=list)
    misfit: float = float("nan")
    stretches: list[tuple[float, float]] = field(default_factory=list)
    contradiction: str = ""

    def add_stretches(self, t: Array, doubtful: NDArray[np.bool_]) -> None:
        """Add the stretches of consecutive doubtful rows at times `t`."""
        for start, end in runs(doubtful):
            first, last = float(t[start]), float(t[end - 1])
            if self.stretches and start == 0 and first - self.stretches[-1][1] < MERGED:
                first = self.stretches.pop()[0]
            self.stretches.append((first, last))

    def add(self, t: Array, shares: Array, valid: Array, stride: int) -> None:
        """Add blocks: times, variances by assumption, numbers of valid rows."""
        items = item_shares(shares)
        self.rows += float(valid.sum())
        self.variances = self.variances + valid @ items
        self.t.append(t[::stride])
        self.series.append(items[::stride])

    @property
    def std(self) -> float:
        """Standard deviation of the position, rms over the valid rows [rad]; NaN without any."""
        return float(np.sqrt(self.variances.sum() / self.rows)) if self.rows else float("nan")

    @property
    def contributions(self) -> list[Contribution]:
        """Contributions, the largest first."""
        if not self.rows:
            return []
        remedies = {item.name: item.remedy for item in ITEMS}
        stds = np.sqrt(self.variances / self.rows)
        listed = [
            Contribution(name, float(std), remedies.get(name, ""))
            for name, std in zip(NAMES, stds, strict=True)
        ]
        return sorted(listed, key=lambda contribution: -contribution.std)

    @property
    def advice(self) -> str:
        """What to measure next, and what it gains; empty without a valid row."""
        for contribution in self.contributions:
            if contribution.remedy:
                rest = np.sqrt(max(self.std**2 - contribution.std**2, 0.0))
                return (
                    f"To gain most, {contribution.remedy}: without the error of the "
                    f"{contribution.name}, the standard deviation of the position would be "
                    f"{np.degrees(rest):.2g}° instead of {np.degrees(self.std):.2g}°."
                )
        return ""

    def columns(self) -> dict[str, Array]:
        """Return the series: t [s], and the variance of each item [rad^2]."""
        if not self.t:
            return {}
        series = np.concatenate(self.series)
        names = {name: series[:, n] for n, name in enumerate(NAMES)}
        return {"t": np.concatenate(self.t)} | names
