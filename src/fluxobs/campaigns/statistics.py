"""Statistics of a campaign's rows: yields with intervals, and indices of the tolerances."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import polars as pl
from numpy.typing import NDArray
from scipy.stats import beta

from ..core.arrays import Array
from .specification import GoodTable, LimitTable, Specification

#: Confidence of all intervals.
CONFIDENCE = 0.95
#: Smallest number of rows per bin, and largest number of bins, for the index of a quantity.
MIN_IN_BIN, MAX_BINS = 20, 32
#: Smallest number of scenarios for which indices are computed.
FEWEST = 4 * MIN_IN_BIN
#: Number of resamplings for the interval of an index.
RESAMPLED = 200


class Yield(NamedTuple):
    """Numbers of good and of all scenarios, with the Clopper-Pearson interval of the good share."""

    good: int
    of: int

    @property
    def share(self) -> float:
        return self.good / self.of

    @property
    def interval(self) -> tuple[float, float]:
        """Exact interval of a binomial share (Clopper and Pearson, doi:10.1093/biomet/26.4.404)."""
        tail, k, n = (1 - CONFIDENCE) / 2, self.good, self.of
        lower = float(beta.ppf(tail, k, n - k + 1)) if k else 0.0
        upper = float(beta.ppf(1 - tail, k + 1, n - k)) if k < n else 1.0
        return lower, upper

    def __str__(self) -> str:
        low, high = self.interval
        return f"{100 * self.share:.1f} % ({100 * low:.1f} to {100 * high:.1f} %)"


def is_good(table: GoodTable) -> pl.Expr:
    """Return the condition that a scenario is simulated, has a valid row and meets the limits."""
    conditions = [pl.col("failed").is_null(), pl.col("rms").is_not_null()]
    for name in ("rms", "worst"):
        limit = getattr(table, name)
        if limit is not None:
            conditions.append(pl.col(name) <= np.radians(limit))
    if table.valid is not None:
        conditions.append(pl.col("valid") >= table.valid)
    if table.first_valid is not None:
        conditions.append(pl.col("first_valid") <= table.first_valid)
    if table.losses is not None:
        conditions.append(pl.col("losses") <= table.losses)
    return pl.all_horizontal(condition.fill_null(False) for condition in conditions)


def in_words(table: GoodTable) -> str:
    """Describe the criterion of a good scenario: "2° rms, 10° at most, …"."""
    conditions = []
    if table.rms is not None:
        conditions.append(f"{table.rms:g}° rms")
    if table.worst is not None:
        conditions.append(f"{table.worst:g}° at most")
    if table.valid is not None:
        conditions.append(f"valid on {100 * table.valid:g} % of the rows")
    if table.first_valid is not None:
        conditions.append(f"valid after {table.first_valid:g} s")
    if table.losses is not None:
        conditions.append(f"lost {table.losses} times at most" if table.losses else "never lost")
    return ", ".join(conditions) or "valid at least once"


def group(rows: pl.DataFrame, machine: str | None, observer: str | None) -> pl.DataFrame:
    """Return the rows of one machine (None: all) and one observer (None: all)."""
    if machine is not None:
        rows = rows.filter(pl.col("machine") == machine)
    return rows if observer is None else rows.filter(pl.col("observer") == observer)


def yield_of(rows: pl.DataFrame, table: GoodTable) -> Yield:
    """Count the good rows."""
    return Yield(int(rows.select(is_good(table).sum()).item()), len(rows))


class Verdict(NamedTuple):
    """Result of a limit of the specification for one observer on one machine."""

    machine: str
    observer: str
    wanted: float
    found: Yield

    @property
    def met(self) -> bool:
        return self.found.share >= self.wanted

    def __str__(self) -> str:
        lower, upper = self.found.interval
        doubt = (
            "" if not lower <= self.wanted <= upper else "; more scenarios are needed to be sure"
        )
        outcome = "met" if self.met else "missed"
        return (
            f"{outcome}: {self.observer} on {self.machine}: {self.found}, wanted "
            f"{100 * self.wanted:g} %{doubt}"
        )


def verdicts(specification: Specification, rows: pl.DataFrame) -> list[Verdict]:
    """Evaluate each limit for all observers and machines to which it applies."""

    def pairs_of(limit: LimitTable) -> Iterator[tuple[str, str]]:
        for machine in specification.machines:
            for table in specification.observers:
                if limit.machine in (None, machine) and limit.observer in (None, table.name):
                    yield machine, table.name

    return [
        Verdict(
            specification.called(machine),
            name,
            limit.good,
            yield_of(group(rows, machine, name), specification.good),
        )
        for limit in specification.limits
        for machine, name in pairs_of(limit)
    ]


class Index(NamedTuple):
    """Share of the position error's variance that one quantity explains, with its interval."""

    quantity: str
    share: float
    low: float
    high: float


def response(rows: pl.DataFrame) -> Array:
    """Return the response that the indices explain: the logarithm of the rms position error.

    The logarithm suits errors that spread over decades. A record without a valid row gets the error
    of a uniformly distributed angle, π/√3.
    """
    rms = rows["rms"].fill_null(np.pi / np.sqrt(3)).to_numpy()
    return np.asarray(np.log10(np.maximum(rms, 1e-6)))


def indices(rows: pl.DataFrame, quantities: tuple[str, ...], seed: int = 0) -> list[Index]:
    """Estimate first-order Sobol' indices from the given rows; return the largest first.

    An index ``Var(E[y|x])/Var(y)`` is computed from the means of y in bins of x with equally many
    rows; the bias of chance is removed. Intervals come from resampling the rows. The difference of
    the sum to 1 is due to combinations of quantities, the course and noise. With correlated
    quantities the indices are correlation ratios, which overlap.

    Parameters
    ----------
    rows : DataFrame
        Rows of one machine and observer.
    quantities : tuple of str

    References
    ----------
    I. M. Sobol', Math. Comput. Simul. 55 (2001), doi:10.1016/S0378-4754(00)00270-6; from given
    data: E. Plischke, Reliab. Eng. Syst. Saf. 95 (2010), doi:10.1016/j.ress.2009.11.005.
    """
    y = response(rows)
    if len(y) < FEWEST or not np.var(y) > 0:
        return []
    rng = np.random.default_rng(seed)
    results = []
    for name in quantities:
        x = rows[name].to_numpy()
        if not np.ptp(x) > 0:
            continue
        share = _first_order(x, y)
        resampled = []
        for _ in range(RESAMPLED):
            pick = rng.integers(len(y), size=len(y))
            resampled.append(_first_order(x[pick], y[pick]))
        # Repeated rows in a resample increase the index: shift the mean back to the estimate.
        spread = np.asarray(resampled) - np.mean(resampled) + share
        lower, upper = np.quantile(spread, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
        results.append(Index(name, max(share, 0.0), max(float(lower), 0.0), max(float(upper), 0.0)))
    return sorted(results, key=lambda index: -index.share)


def _first_order(x: Array, y: Array) -> float:
    """Return the share of y's variance that the mean of y over x explains, without bias."""
    n = len(y)
    bins = int(np.clip(n // MIN_IN_BIN, 2, MAX_BINS))
    order = np.argsort(x, kind="stable")
    _, levels = np.unique(x, return_inverse=True)
    if levels.max() < bins:  # a grid or a choice: one bin per value
        bin_index = levels
    else:
        bin_index = np.empty(n, int)
        bin_index[order] = np.arange(n) * bins // n
    count = np.bincount(bin_index)
    mean = np.bincount(bin_index, y) / count
    total = float(np.sum((y - y.mean()) ** 2))
    between = float(np.sum(count * (mean - y.mean()) ** 2))
    within = (total - between) / max(n - len(count), 1)
    return (between - (len(count) - 1) * within) / total


class Pair(NamedTuple):
    """Counts of good and of all scenarios in cells of two quantities, with the cells' edges."""

    x: str
    y: str
    x_edges: Array
    y_edges: Array
    good: NDArray[np.int64]
    of: NDArray[np.int64]


def pair(rows: pl.DataFrame, table: GoodTable, x: str, y: str, max_cells: int = 8) -> Pair:
    """Count good and all scenarios in cells of two quantities, about thirty scenarios per cell."""
    cells = int(np.clip(np.sqrt(len(rows) / 30), 2, max_cells))
    good = rows.select(is_good(table)).to_series().to_numpy()
    edges = []
    for name in (x, y):
        values = rows[name].to_numpy()
        edges.append(np.unique(np.quantile(values, np.linspace(0, 1, cells + 1))))
    a, b = rows[x].to_numpy(), rows[y].to_numpy()
    count = np.histogram2d(a, b, bins=edges)[0].astype(int)
    good_count = np.histogram2d(a[good], b[good], bins=edges)[0].astype(int)
    return Pair(x, y, edges[0], edges[1], good_count, count)
