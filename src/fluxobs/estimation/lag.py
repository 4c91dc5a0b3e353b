"""The lag of the voltages, if nobody states it: two hypotheses, weighed by the log.

Most drives apply a voltage one sample after the currents from which it was computed (lag -1), or
log it so that it acts from its row on (lag 0). The smoother estimates the log with both; each
estimate allows for a spread around its lag. The costs of the two are the negative logarithms of
their likelihoods, and the weights follow from Bayes' rule with equal priors. Where the log cannot
decide, the difference of the two estimates is part of the standard deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..core.arrays import Array
from ..machines.model.frames import wrap
from ..smoothing.record import QUANTITIES, SHARES, SmoothedRecord

#: Lags to try, relative to the lag with which a log is read: 0 [samples].
LAGS = (0, -1)
#: A hypothesis with a smaller weight is dropped.
LEAST_WEIGHT = 0.003
#: From this weight of another lag on, the log cannot decide. The weights are calibrated: of 96
#: drives with every error at once, the wrong lag has more than 0.95 of the weight on 9 %, where
#: the other assumptions replace the lag (benchmarks/whole_log.py --unknown-lag).
UNDECIDED = 0.05


@dataclass(frozen=True)
class LagDecision:
    """Lag that was learnt from the log.

    Attributes
    ----------
    lag : float
        In samples.
    weights : dict
        Probability of each lag.
    position_difference : float
        Rms difference of the positions between the lag and the next probable one [rad]; NaN if
        the other was dropped.
    """

    lag: float
    weights: dict[float, float]
    position_difference: float

    @property
    def decided(self) -> bool:
        """Whether the log decides."""
        return self.weights[self.lag] > 1 - UNDECIDED


def weights_of(costs: Sequence[float]) -> Array:
    """Return the weights of hypotheses with these costs."""
    least = min(costs)
    likelihood = np.exp(-(np.asarray(costs) - least))
    return np.asarray(likelihood / likelihood.sum())


def shifted(voltage: Array, shift: int) -> Array:
    """Return the voltages of the intervals if the lag is larger by `shift` <= 0 samples.

    The first intervals repeat the first voltage.
    """
    if shift == 0:
        return voltage
    return np.concatenate([np.repeat(voltage[:1], -shift, axis=0), voltage[:shift]])


def mixed(
    records: Sequence[SmoothedRecord], weights: Sequence[float]
) -> tuple[SmoothedRecord, float]:
    """Return mean and standard deviation over the hypotheses.

    Parameters
    ----------
    records : sequence of SmoothedRecord
        The most probable first; all of the same rows and blocks.
    weights : sequence of float
        Probabilities; their sum is almost 1.

    Returns
    -------
    SmoothedRecord
        The most probable record with the mean outputs; its item "lag" contains the difference.
    float
        Mean square of the difference of the positions to the second record [rad^2].
    """
    best = records[0]
    if len(records) == 1:
        return best, 0.0
    if any(other.shares.shape != best.shares.shape for other in records):
        return best, 0.0  # another start has other blocks; such a hypothesis has no weight
    outputs, shares = dict(best.outputs), best.shares.copy()
    share = np.array(weights[1:]) / sum(weights)
    square = 0.0
    for name, values in best.outputs.items():
        std = f"{name}_std"
        if std not in outputs:
            continue
        differences = [other.outputs[name] - values for other in records[1:]]
        if name == "theta_e":
            differences = [wrap(difference) for difference in differences]
            square = float(np.mean(differences[0] ** 2))
        moved = sum_of(share, differences)
        spread = sum_of(share, [difference**2 for difference in differences]) - moved**2
        inner = outputs[std] ** 2 + sum_of(
            share, [other.outputs[std] ** 2 - outputs[std] ** 2 for other in records[1:]]
        )
        outputs[name] = wrap(values + moved) if name == "theta_e" else values + moved
        outputs[std] = np.sqrt(inner + spread)
        if name in QUANTITIES:
            _add_share(shares, QUANTITIES.index(name), spread, best.model.rows_per_block)
    return replace(best, outputs=outputs, shares=shares), square


def sum_of(weights: Array, values: Sequence[Array]) -> Array:
    """Return the weighted sum."""
    total = np.zeros(len(values[0]))
    for weight, value in zip(weights.tolist(), values, strict=True):
        total = total + weight * value
    return total


def _add_share(shares: Array, quantity: int, variance: Array, rows_per_block: int) -> None:
    blocks = min(len(shares), len(variance) // rows_per_block)
    whole = variance[: blocks * rows_per_block].reshape(blocks, rows_per_block)
    shares[:blocks, quantity, SHARES.index("lag")] += whole.mean(axis=1)
