"""Hypotheses about a log, weighed by how well the smoother explains the log with each.

A Gaussian prior does not describe an inductance in a machine file: most files are right within a
tenth, some are those of another machine, or the machine is salient or saturates. If the learnt
inductance leaves its prior, other inductances are tried. Costs are negative logarithms of the
likelihood and of the prior; the weights follow from Bayes' rule.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..core.arrays import Array
from ..machines.model.flux_map import LinearMap
from ..machines.model.frames import wrap
from ..smoothing.record import (
    QUANTITIES,
    SHARES,
    Assumed,
    Cost,
    SmoothedRecord,
    SmoothingModel,
)
from .course import Course, no_course
from .fit import CONTRADICTION


@dataclass
class Hypothesis:
    """A possible error of the log's lag or of the machine file, and what the log teaches then.

    Attributes
    ----------
    shift : int
        [samples].
    inductance : float
        True inductance over that of the machine file.
    weight : float
        Probability.
    course : Course
    prior : float
        Negative logarithm of its odds.
    costs : list of Cost
        Of each segment that was learnt.
    """

    shift: int
    inductance: float = 1.0
    weight: float = 1.0
    course: Course = field(default_factory=no_course)
    prior: float = 0.0
    costs: list[Cost] = field(default_factory=list)


#: A hypothesis with a smaller weight is dropped.
LEAST_WEIGHT = 0.003
#: Other inductances are tried if the learnt one is off by this many prior standard deviations. The
#: prior holds it back: with 1.4 to 2.2 times the inductance of the file, it is off by 0.9 to 3.3
#: (benchmarks/faults.py --kind salient).
SUSPICIOUS = 0.7
#: Factors to try, and the odds that a file is that wrong. With 1/40, a measured log loses
#: its valid rows (benchmarks/measured.py).
FACTORS, ODDS = (1.25, 1.6, 2.2), 1 / 200


def other_inductances(model: SmoothingModel, assumed: Assumed) -> list[tuple[float, float]]:
    """Return factors on the inductance to try, each with the cost of its prior.

    Only a machine with one inductance and magnets has such hypotheses.
    """
    if not model.numbers["one_inductance"] or not model.magnets or not model.stds["L_d"] > 0:
        return []
    deviation = assumed.deviations["L_d"]
    if not SUSPICIOUS < abs(deviation) / model.stds["L_d"] < CONTRADICTION:
        return []
    cost = -float(np.log(ODDS / len(FACTORS)))
    return [(factor if deviation > 0 else 1 / factor, cost) for factor in FACTORS]


def with_inductance(model: SmoothingModel, factor: float) -> SmoothingModel:
    """Return the model with another inductance."""
    if factor == 1:
        return model
    fields = model.map
    flux_map = LinearMap(fields["psi"], factor * fields["L_d"], factor * fields["L_q"])
    return replace(model, map=flux_map.core())


#: Limit of the correlation of neighbouring innovations.
MOST_CORRELATION = 0.9


def total_costs(costs: Sequence[Cost]) -> list[float]:
    """Return the costs of hypotheses about one record.

    The innovations of the hypothesis that explains the record best show how many of them are
    independent. A wrong hypothesis has correlated innovations, which must not make it cheaper.
    """
    best = min(costs, key=lambda cost: cost.sum)
    correlation = min(best.correlation, MOST_CORRELATION)
    share = (1 - correlation) / (1 + correlation)
    return [cost.prior + share * cost.innovations for cost in costs]


def weights_of(costs: Sequence[float]) -> Array:
    """Return the weights of hypotheses with these costs."""
    least = min(costs)
    likelihood = np.exp(-(np.asarray(costs) - least))
    return np.asarray(likelihood / likelihood.sum())


def mixed(
    records: Sequence[SmoothedRecord], weights: Sequence[float], differs: Sequence[str]
) -> tuple[SmoothedRecord, float | None]:
    """Return mean and standard deviation over the hypotheses.

    Parameters
    ----------
    records : sequence of SmoothedRecord
        The most probable first; all of the same rows and blocks.
    weights : sequence of float
        Probabilities; their sum is almost 1.
    differs : sequence of str
        The share of the budget to which the difference of each other record belongs.

    Returns
    -------
    SmoothedRecord
        The most probable record with the mean outputs; its shares contain the differences.
    float or None
        Mean square of the difference of the positions to the most probable other lag [rad^2].
    """
    best = records[0]
    if len(records) == 1:
        return best, None
    if any(other.shares.shape != best.shares.shape for other in records):
        return best, None  # another start has other blocks; such a hypothesis has no weight
    outputs, shares = dict(best.outputs), best.shares.copy()
    share = np.array(weights[1:]) / sum(weights)
    square: float | None = None
    for name, values in best.outputs.items():
        std = f"{name}_std"
        if std not in outputs:
            continue
        differences = [other.outputs[name] - values for other in records[1:]]
        if name == "theta_e":
            differences = [wrap(difference) for difference in differences]
            lags = [d for d, of in zip(differences, differs, strict=True) if of == "lag"]
            square = float(np.mean(lags[0] ** 2)) if lags else None
        moved = sum_of(share, differences)
        spread = sum_of(share, [difference**2 for difference in differences]) - moved**2
        inner = outputs[std] ** 2 + sum_of(
            share, [other.outputs[std] ** 2 - outputs[std] ** 2 for other in records[1:]]
        )
        outputs[name] = wrap(values + moved) if name == "theta_e" else values + moved
        outputs[std] = np.sqrt(inner + spread)
        if name in QUANTITIES:
            _add_share(shares, (name, differs[0]), spread, best.model.rows_per_block)
    return replace(best, outputs=outputs, shares=shares), square


def sum_of(weights: Array, values: Sequence[Array]) -> Array:
    """Return the weighted sum."""
    total = np.zeros(len(values[0]))
    for weight, value in zip(weights.tolist(), values, strict=True):
        total = total + weight * value
    return total


def _add_share(shares: Array, place: tuple[str, str], variance: Array, rows_per_block: int) -> None:
    blocks = min(len(shares), len(variance) // rows_per_block)
    whole = variance[: blocks * rows_per_block].reshape(blocks, rows_per_block)
    quantity, share = place
    shares[:blocks, QUANTITIES.index(quantity), SHARES.index(share)] += whole.mean(axis=1)
