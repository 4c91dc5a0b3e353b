"""Search for the worst scenario within tolerance, and for the probability of failures.

Both searches use the standard normal scores of the quantities that vary. The origin of the scores
is the nominal drive; points far from the origin are unlikely.
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

#: Scenarios per generation: one batch.
GENERATION = 64
#: Limit of the scores in standard deviations; points beyond the limit are outside the tolerance.
BOUND = 4.0
#: First step of the search, in standard deviations.
STEP = 0.7
#: Share of the nominal distribution in the sampling mixture; the inverse of this share bounds the
#: weights. Share of the worst scenarios, to which the mixture moves.
DEFENSIVE, ELITE = 0.3, 0.1
#: Effective number of failures below which the estimate and its interval are unreliable.
FEW = 10
#: Largest number of moves towards the failures.
MOVES = 6

#: Function of scores (n, d) and the numbers of the scenarios whose course and noise are used.
#: Returns rows in the same order.
Evaluate = Callable[[Array, Sequence[int]], pl.DataFrame]


def evaluator(specification: Specification, machine: str, observer: str) -> Evaluate:
    """Return a function that simulates points of one machine with one observer.

    Raises
    ------
    UsageError
        There is no such machine or observer, or no quantity varies.
    """
    table = specification.observer(observer)
    if machine not in specification.machines:
        raise UsageError(f"no machine {machine!r}{nearest(machine, specification.machines)}")
    if not specification.varied:
        raise UsageError("no quantity varies in this campaign: nothing can be searched")
    single_observer = specification.model_copy(update={"observers": [table]})

    def evaluate(scores: Array, like: Sequence[int]) -> pl.DataFrame:
        drawn = [
            Scenario(
                k,
                machine,
                at_point(single_observer, ndtr(score), lender),
                single_observer.seed,
                lender,
            )
            for k, (score, lender) in enumerate(zip(scores, like, strict=True))
        ]
        return pl.DataFrame(rows_for(single_observer, drawn), schema=schema(single_observer)).sort(
            "number"
        )

    return evaluate


@dataclass(frozen=True, eq=False)
class Worst:
    """The worst scenario that a search found.

    Attributes
    ----------
    values : dict
        The scenario's drawn quantities, by name.
    like : int
        Number of the campaign's scenario whose course and noise are used.
    row : dict
        Its row.
    tried : int
        Number of simulated scenarios.
    history : tuple of float
        Worst error of each generation [rad].
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
    """Search the distributions of the tolerances for the largest error.

    CMA-ES over the scores (N. Hansen, the package `cma`). The search starts at the campaign's worst
    scenario, with its course and noise. Without rows, the search starts at the nominal drive.

    Parameters
    ----------
    start : DataFrame, optional
        Rows of the campaign.
    budget : int
        Approximate number of scenarios to simulate.
    measure : str
        Column to maximise: worst, rms.

    Raises
    ------
    FluxobsError
        The package is missing, or no tried scenario has a valid row.
    """
    try:
        import cma
    except ImportError:
        raise FluxobsError(
            'the search needs the extra "campaign"; install it: pip install "fluxobs[campaign]"'
        ) from None
    simulate = evaluate or evaluator(specification, machine, observer)
    first_number = specification.machines.index(machine) * specification.scenarios
    like, centre = first_number, np.zeros(len(specification.varied))
    if start is not None:
        candidates = start.filter(
            (pl.col("machine") == machine)
            & (pl.col("observer") == observer)
            & pl.col(measure).is_not_null()
        ).sort(measure, descending=True)
        if len(candidates):
            like = int(candidates["number"][0])
            centre = ndtri(points(specification, like, like + 1)[0])
    options = {
        "popsize": GENERATION,
        "bounds": [-BOUND, BOUND],
        "seed": seed + 1,  # CMA-ES replaces seed 0 by the clock
        "verbose": -9,
        "maxfevals": budget,
    }
    strategy = cma.CMAEvolutionStrategy(np.clip(centre, -BOUND, BOUND), STEP, options)
    best: tuple[float, Array, dict[str, Any]] | None = None
    history: list[float] = []
    tried = 0
    while tried < budget and not strategy.stop():
        generation = np.asarray(strategy.ask())
        rows = simulate(generation, [like] * len(generation))
        errors = rows[measure].fill_null(0.0).to_numpy()
        # Penalise unlikely points by the squared distance, as in the normal density.
        log_error = np.log(np.maximum(errors, 1e-9))
        strategy.tell(list(generation), list(-log_error + 1e-2 * np.sum(generation**2, axis=1)))
        index = int(np.argmax(errors))
        tried += len(generation)
        if errors[index] > 0 and (best is None or errors[index] > best[0]):
            best = float(errors[index]), generation[index], rows.row(index, named=True)
        history.append(float(errors[index]))
        progress(min(tried, budget), budget)
    if best is None:
        raise FluxobsError(
            f"{observer} on {machine}: no tried scenario has a valid row, so there is no error to "
            f"maximise"
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
        Number of failures in the final estimate; number of all simulated scenarios.
    effective : float
        Effective number of samples, (Σw)²/Σw² over the failures; a low number means a poor
        estimate.
    """

    probability: float
    std: float
    failures: int
    tried: int
    effective: float

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of a normal distribution, clipped to 0…1."""
        half_width = float(ndtri((1 + CONFIDENCE) / 2)) * self.std
        return max(self.probability - half_width, 0.0), min(self.probability + half_width, 1.0)

    def __str__(self) -> str:
        lower, upper = self.interval
        if not self.failures:
            return f"no failure among {self.tried} scenarios"
        too_few = "; too few for a reliable estimate: increase --budget"
        warning = "" if self.effective >= FEW else too_few
        return (
            f"{self.probability:.2g} ({lower:.2g} to {upper:.2g}), from {self.failures} failures "
            f"(effective number {self.effective:.0f}) among {self.tried} scenarios{warning}"
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
    """Estimate the probability that a scenario is not good, by importance sampling.

    The cross-entropy method moves the mean of the scores towards the failures in steps. The second
    half of the budget is drawn from a mixture of the nominal and the moved distribution and
    weighted by the ratio of the densities. Courses and noise are drawn as in the campaign.

    Parameters
    ----------
    budget : int
        Approximate number of scenarios to simulate.
    good : GoodTable, optional
        Criterion of good scenarios; default the specification's criterion.

    References
    ----------
    R. Y. Rubinstein and D. P. Kroese, The Cross-Entropy Method, Springer 2004,
    doi:10.1007/978-1-4757-4321-0; A. Owen and Y. Zhou, Safe and effective importance sampling,
    J. Am. Stat. Assoc. 95 (2000), doi:10.1080/01621459.2000.10473909 (the mixture).
    """
    simulate = evaluate or evaluator(specification, machine, observer)
    table = specification.good if good is None else good
    rng = np.random.default_rng([seed, 7])
    dimension, machine_index = len(specification.varied), specification.machines.index(machine)
    # Scenario numbers beyond those of the machine give new courses.
    number = machine_index * specification.scenarios + specification.scenarios
    mean, tried = np.zeros(dimension), 0

    def simulate_scores(scores: Array) -> tuple[pl.DataFrame, NDArray[np.bool_]]:
        nonlocal number, tried
        rows = simulate(scores, range(number, number + len(scores)))
        number += len(scores)
        tried += len(scores)
        progress(min(tried, budget), budget)
        return rows, ~rows.select(is_good(table)).to_series().to_numpy()

    generation = max(GENERATION, budget // (2 * MOVES))
    for _ in range(MOVES):
        scores = rng.standard_normal((generation, dimension)) + mean
        rows, failed = simulate_scores(scores)
        errors = rows["rms"].fill_null(np.inf).to_numpy()
        elite = failed if failed.mean() > ELITE else errors >= np.quantile(errors, 1 - ELITE)
        weight = np.exp(-scores[elite] @ mean)  # ratio of the densities, up to a constant factor
        mean = np.average(scores[elite], axis=0, weights=weight)
        distance = float(np.linalg.norm(mean))
        mean = mean * min(1.0, BOUND / max(distance, 1e-12))
        if failed.mean() > ELITE:
            break
    count = max(GENERATION, budget - tried)
    moved = rng.random(count) >= DEFENSIVE
    scores = rng.standard_normal((count, dimension)) + np.where(moved[:, None], mean, 0.0)
    _, failed = simulate_scores(scores)
    ratio = np.exp(scores @ mean - mean @ mean / 2)  # moved density over the nominal one
    weight = 1 / (DEFENSIVE + (1 - DEFENSIVE) * ratio)
    weighted_failures = weight * failed
    std = float(np.std(weighted_failures, ddof=1) / np.sqrt(count))
    failure_weights = weight[failed]
    effective = (
        float(failure_weights.sum() ** 2 / (failure_weights**2).sum())
        if len(failure_weights)
        else 0.0
    )
    return Rare(float(weighted_failures.mean()), std, int(failed.sum()), tried, effective)
