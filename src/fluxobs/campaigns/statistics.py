"""What the rows of a campaign say: yields with intervals, and which tolerance matters."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import polars as pl
from numpy.typing import NDArray
from scipy.stats import beta

from ..core.arrays import Array
from .specification import GoodTable, LimitTable, Specification

#: All intervals are of this confidence.
CONFIDENCE = 0.95
#: Bins of a quantity for its index: at least so many rows each, at most so many bins.
LEAST_IN_BIN, MOST_BINS = 20, 32
#: Fewest scenarios from which indices are told.
FEWEST = 4 * LEAST_IN_BIN
#: Resamplings for the interval of an index.
RESAMPLED = 200


class Yield(NamedTuple):
    """Good scenarios of all, and the Clopper-Pearson interval of their share."""

    good: int
    of: int

    @property
    def share(self) -> float:
        return self.good / self.of

    @property
    def interval(self) -> tuple[float, float]:
        """Exact interval of a binomial share (Clopper and Pearson, doi:10.1093/biomet/26.4.404)."""
        tail, k, n = (1 - CONFIDENCE) / 2, self.good, self.of
        low = float(beta.ppf(tail, k, n - k + 1)) if k else 0.0
        high = float(beta.ppf(1 - tail, k + 1, n - k)) if k < n else 1.0
        return low, high

    def __str__(self) -> str:
        low, high = self.interval
        return f"{100 * self.share:.1f} % ({100 * low:.1f} to {100 * high:.1f} %)"


def is_good(table: GoodTable) -> pl.Expr:
    """Whether a row is good. One without a valid row, or that could not be simulated, is not."""
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
    """What good means: "2° rms, 10° at most, …"."""
    words = []
    if table.rms is not None:
        words.append(f"{table.rms:g}° rms")
    if table.worst is not None:
        words.append(f"{table.worst:g}° at most")
    if table.valid is not None:
        words.append(f"valid on {100 * table.valid:g} % of the rows")
    if table.first_valid is not None:
        words.append(f"valid after {table.first_valid:g} s")
    if table.losses is not None:
        words.append(f"lost {table.losses} times at most" if table.losses else "never lost")
    return ", ".join(words) or "ever valid"


def group(rows: pl.DataFrame, machine: str | None, observer: str | None) -> pl.DataFrame:
    """Rows of one machine, or all; of one observer, or all."""
    if machine is not None:
        rows = rows.filter(pl.col("machine") == machine)
    return rows if observer is None else rows.filter(pl.col("observer") == observer)


def yield_of(rows: pl.DataFrame, table: GoodTable) -> Yield:
    """Good rows of some."""
    return Yield(int(rows.select(is_good(table).sum()).item()), len(rows))


class Verdict(NamedTuple):
    """A limit of the specification, for one observer on one machine."""

    machine: str
    observer: str
    wanted: float
    found: Yield

    @property
    def met(self) -> bool:
        return self.found.share >= self.wanted

    def __str__(self) -> str:
        low, high = self.found.interval
        sure = "" if not low <= self.wanted <= high else "; too few scenarios to be sure"
        word = "met" if self.met else "missed"
        return (
            f"{word}: {self.observer} on {self.machine}: {self.found}, wanted "
            f"{100 * self.wanted:g} %{sure}"
        )


def verdicts(specification: Specification, rows: pl.DataFrame) -> list[Verdict]:
    """Every limit, for every observer and machine that it names."""

    def asked(limit: LimitTable) -> Iterator[tuple[str, str]]:
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
        for machine, name in asked(limit)
    ]


class Index(NamedTuple):
    """How much of the variance of the position error one quantity explains, with its interval."""

    quantity: str
    share: float
    low: float
    high: float


def response(rows: pl.DataFrame) -> Array:
    """What the indices explain: the logarithm of the rms position error, for errors spread over
    decades; an observer without a valid row has the error of an angle that is not known."""
    rms = rows["rms"].fill_null(np.pi / np.sqrt(3)).to_numpy()
    return np.asarray(np.log10(np.maximum(rms, 1e-6)))


def indices(rows: pl.DataFrame, quantities: tuple[str, ...], seed: int = 0) -> list[Index]:
    """First-order Sobol' indices from the rows as they are, the largest first.

    ``Var(E[y|x])/Var(y)`` from the means of y in bins of x with equally many rows, less what chance
    alone gives them. Intervals by resampling the rows. What the indices leave of 1 is due to
    quantities together, to the course and to noise. With correlated quantities they are correlation
    ratios: those of quantities that go together overlap.

    Parameters
    ----------
    rows : DataFrame
        Of one machine and observer.
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
    out = []
    for name in quantities:
        x = rows[name].to_numpy()
        if not np.ptp(x) > 0:
            continue
        found = _first_order(x, y)
        again = []
        for _ in range(RESAMPLED):
            pick = rng.integers(len(y), size=len(y))
            again.append(_first_order(x[pick], y[pick]))
        # Resampled rows repeat, which looks like an effect: their mean is moved back.
        spread = np.asarray(again) - np.mean(again) + found
        low, high = np.quantile(spread, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
        out.append(Index(name, max(found, 0.0), max(float(low), 0.0), max(float(high), 0.0)))
    return sorted(out, key=lambda one: -one.share)


def _first_order(x: Array, y: Array) -> float:
    """Share of the variance of y that the mean of y over x explains, without bias."""
    n = len(y)
    bins = int(np.clip(n // LEAST_IN_BIN, 2, MOST_BINS))
    order = np.argsort(x, kind="stable")
    _, levels = np.unique(x, return_inverse=True)
    if levels.max() < bins:  # a grid, or a choice: its values are the bins
        place = levels
    else:
        place = np.empty(n, int)
        place[order] = np.arange(n) * bins // n
    count = np.bincount(place)
    mean = np.bincount(place, y) / count
    total = float(np.sum((y - y.mean()) ** 2))
    between = float(np.sum(count * (mean - y.mean()) ** 2))
    within = (total - between) / max(n - len(count), 1)
    return (between - (len(count) - 1) * within) / total


class Pair(NamedTuple):
    """Share of good scenarios over two quantities: edges, and good and all in each cell."""

    x: str
    y: str
    x_edges: Array
    y_edges: Array
    good: NDArray[np.int64]
    of: NDArray[np.int64]


def pair(rows: pl.DataFrame, table: GoodTable, x: str, y: str, most: int = 8) -> Pair:
    """Yield over a pair of quantities, in cells of about thirty scenarios."""
    cells = int(np.clip(np.sqrt(len(rows) / 30), 2, most))
    good = rows.select(is_good(table)).to_series().to_numpy()
    edges = []
    for name in (x, y):
        values = rows[name].to_numpy()
        edges.append(np.unique(np.quantile(values, np.linspace(0, 1, cells + 1))))
    a, b = rows[x].to_numpy(), rows[y].to_numpy()
    of = np.histogram2d(a, b, bins=edges)[0].astype(int)
    hit = np.histogram2d(a[good], b[good], bins=edges)[0].astype(int)
    return Pair(x, y, edges[0], edges[1], hit, of)
