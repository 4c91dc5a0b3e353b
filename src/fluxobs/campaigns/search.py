"""Towards the worst: the scenario within tolerance that breaks an observer, and how rare that is.

Both move in the standard normal scores of the quantities that vary: the origin is the nominal
drive, and what is far from it is unlikely.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from ..core.arrays import Array
from ..core.validation import nearest
from ..errors import FluxobsError, UsageError
from .columns import schema
from .draws import Scenario, at_point, points
from .rows import rows_for
from .specification import GoodTable, Specification
from .statistics import CONFIDENCE, is_good

#: Scenarios of a generation: one batch.
GENERATION = 64
#: Scores stay within this many standard deviations: beyond, nothing is within tolerance.
BOUND = 4.0
#: First step of the search, in standard deviations.
STEP = 0.7
#: Share of the nominal distribution in the mixture that looks for failures, so that no weight is
#: above its inverse; share of the worst that the mixture moves to.
DEFENSIVE, ELITE = 0.3, 0.1
#: Effective number of failures below which the estimate and its interval mean little.
FEW = 10
#: Largest number of moves towards the failures.
MOVES = 6

#: Scores (n, d) and the scenarios that lend course and noise → rows in that order.
Evaluate = Callable[[Array, Sequence[int]], pl.DataFrame]


def evaluator(specification: Specification, machine: str, observer: str) -> Evaluate:
    """Simulates points of one machine with one observer.

    Raises
    ------
    UsageError
        There is no such machine or observer, or nothing varies.
    """
    table = specification.observer(observer)
    if machine not in specification.machines:
        raise UsageError(f"no machine {machine!r}{nearest(machine, specification.machines)}")
    if not specification.varied:
        raise UsageError("nothing varies in this campaign: there is nothing to search")
    alone = specification.model_copy(update={"observers": [table]})

    def evaluate(scores: Array, like: Sequence[int]) -> pl.DataFrame:
        drawn = [
            Scenario(k, machine, at_point(alone, ndtr(score), other), alone.seed, other)
            for k, (score, other) in enumerate(zip(scores, like, strict=True))
        ]
        return pl.DataFrame(rows_for(alone, drawn), schema=schema(alone)).sort("number")

    return evaluate


@dataclass(frozen=True, eq=False)
class Worst:
    """The worst scenario that a search found.

    Attributes
    ----------
    values : dict
        What is drawn, by name.
    like : int
        The scenario of the campaign whose course and noise it has.
    row : dict
        Its row.
    tried : int
        Simulated scenarios.
    history : tuple of float
        Worst error by generation [rad].
    """

    values: dict[str, float]
    like: int
    row: dict[str, Any]
    tried: int
    history: tuple[float, ...]


def find_worst(
    specification: Specification,
    machine: str,
    observer: str,
    start: pl.DataFrame | None = None,
    *,
    budget: int = 1024,
    measure: str = "worst",
    seed: int = 0,
    evaluate: Evaluate | None = None,
    progress: Callable[[int, int], Any] = lambda done, total: None,
) -> Worst:
    """Search for the tolerances, within their distributions, with the largest error.

    CMA-ES over the scores (N. Hansen, the package `cma`), from the worst scenario of the campaign
    and with its course and noise; without rows from the nominal drive.

    Parameters
    ----------
    start : DataFrame, optional
        Rows of the campaign.
    budget : int
        Scenarios to simulate, about.
    measure : str
        Column to make large: worst, rms.

    Raises
    ------
    FluxobsError
        The package is missing, or no scenario that was tried has a valid row.
    """
    try:
        import cma
    except ImportError:
        raise FluxobsError(
            'the search needs the extra "campaign": pip install "fluxobs[campaign]"'
        ) from None
    run = evaluate or evaluator(specification, machine, observer)
    first = specification.machines.index(machine) * specification.scenarios
    like, centre = first, np.zeros(len(specification.varied))
    if start is not None:
        mine = start.filter(
            (pl.col("machine") == machine)
            & (pl.col("observer") == observer)
            & pl.col(measure).is_not_null()
        ).sort(measure, descending=True)
        if len(mine):
            like = int(mine["number"][0])
            centre = ndtri(points(specification, like, like + 1)[0])
    options = {
        "popsize": GENERATION,
        "bounds": [-BOUND, BOUND],
        "seed": seed + 1,  # 0 would be the clock
        "verbose": -9,
        "maxfevals": budget,
    }
    strategy = cma.CMAEvolutionStrategy(np.clip(centre, -BOUND, BOUND), STEP, options)
    best: tuple[float, Array, dict[str, Any]] | None = None
    history: list[float] = []
    tried = 0
    while tried < budget and not strategy.stop():
        asked = np.asarray(strategy.ask())
        rows = run(asked, [like] * len(asked))
        error = rows[measure].fill_null(0.0).to_numpy()
        # What is unlikely costs: half the square of the distance, as in the normal density.
        size = np.log(np.maximum(error, 1e-9))
        strategy.tell(list(asked), list(-size + 1e-2 * np.sum(asked**2, axis=1)))
        k = int(np.argmax(error))
        tried += len(asked)
        if error[k] > 0 and (best is None or error[k] > best[0]):
            best = float(error[k]), asked[k], rows.row(k, named=True)
        history.append(float(error[k]))
        progress(min(tried, budget), budget)
    if best is None:
        raise FluxobsError(
            f"{observer} on {machine}: no scenario that was tried has a valid row; there is no "
            f"error to make large"
        )
    values = at_point(specification, np.asarray(ndtr(best[1])), like)
    return Worst(values, like, best[2], tried, tuple(history))


@dataclass(frozen=True)
class Rare:
    """A small probability of failure.

    Attributes
    ----------
    probability, std : float
        Estimate and its standard deviation.
    failures, tried : int
        Failing scenarios among those of the final estimate; all simulated ones.
    effective : float
        Effective number of samples, (Σw)²/Σw² over the failures: few mean a poor estimate.
    """

    probability: float
    std: float
    failures: int
    tried: int
    effective: float

    @property
    def interval(self) -> tuple[float, float]:
        """Of 95 %, of a normal distribution; from nothing if the std is as large as the value."""
        reach = float(ndtri((1 + CONFIDENCE) / 2)) * self.std
        return max(self.probability - reach, 0.0), min(self.probability + reach, 1.0)

    def __str__(self) -> str:
        low, high = self.interval
        if not self.failures:
            return f"no failure among {self.tried} scenarios"
        few = "" if self.effective >= FEW else "; too few to rely on: a larger --budget helps"
        return (
            f"{self.probability:.2g} ({low:.2g} to {high:.2g}), from {self.failures} failures, "
            f"worth {self.effective:.0f}, among {self.tried} scenarios{few}"
        )


def estimate_rare(
    specification: Specification,
    machine: str,
    observer: str,
    *,
    budget: int = 2048,
    good: GoodTable | None = None,
    seed: int = 0,
    evaluate: Evaluate | None = None,
    progress: Callable[[int, int], Any] = lambda done, total: None,
) -> Rare:
    """Probability that a scenario is not good, by importance sampling.

    The cross-entropy method moves the mean of the scores towards the failures in levels; the final
    half of the budget is drawn from a mixture of the nominal and the moved distribution, and
    weighted by the ratio of the densities. Courses and noise are drawn as in the campaign.

    Parameters
    ----------
    budget : int
        Scenarios to simulate, about.
    good : GoodTable, optional
        When a scenario is good; default the specification's.

    References
    ----------
    R. Y. Rubinstein and D. P. Kroese, The Cross-Entropy Method, Springer 2004,
    doi:10.1007/978-1-4757-4321-0; A. Owen and Y. Zhou, Safe and effective importance sampling,
    J. Am. Stat. Assoc. 95 (2000), doi:10.1080/01621459.2000.10473909 (the mixture).
    """
    run = evaluate or evaluator(specification, machine, observer)
    table = specification.good if good is None else good
    rng = np.random.default_rng([seed, 7])
    d, first = len(specification.varied), specification.machines.index(machine)
    number = first * specification.scenarios + specification.scenarios  # courses of their own
    mean, tried = np.zeros(d), 0

    def drawn(scores: Array) -> tuple[pl.DataFrame, NDArray[np.bool_]]:
        nonlocal number, tried
        rows = run(scores, range(number, number + len(scores)))
        number += len(scores)
        tried += len(scores)
        progress(min(tried, budget), budget)
        return rows, ~rows.select(is_good(table)).to_series().to_numpy()

    each = max(GENERATION, budget // (2 * MOVES))
    for _ in range(MOVES):
        scores = rng.standard_normal((each, d)) + mean
        rows, failed = drawn(scores)
        size = rows["rms"].fill_null(np.inf).to_numpy()
        worst = failed if failed.mean() > ELITE else size >= np.quantile(size, 1 - ELITE)
        weight = np.exp(-scores[worst] @ mean)  # ratio of the densities, but for a factor
        mean = np.average(scores[worst], axis=0, weights=weight)
        length = float(np.linalg.norm(mean))
        mean = mean * min(1.0, BOUND / max(length, 1e-12))
        if failed.mean() > ELITE:
            break
    count = max(GENERATION, budget - tried)
    moved = rng.random(count) >= DEFENSIVE
    scores = rng.standard_normal((count, d)) + np.where(moved[:, None], mean, 0.0)
    _, failed = drawn(scores)
    ratio = np.exp(scores @ mean - mean @ mean / 2)  # moved density over the nominal one
    weight = 1 / (DEFENSIVE + (1 - DEFENSIVE) * ratio)
    value = weight * failed
    std = float(np.std(value, ddof=1) / np.sqrt(count))
    mine = weight[failed]
    effective = float(mine.sum() ** 2 / (mine**2).sum()) if len(mine) else 0.0
    return Rare(float(value.mean()), std, int(failed.sum()), tried, effective)
