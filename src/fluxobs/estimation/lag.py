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
from ..smoothing.record import SHARES, SmoothedRecord

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
    difference : float
        Rms difference of the positions between the lag and the next probable one [rad]; NaN if
        the other was dropped.
    """

    lag: float
    weights: dict[float, float]
    difference: float

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
    best: SmoothedRecord, others: Sequence[tuple[float, SmoothedRecord]]
) -> tuple[SmoothedRecord, float]:
    """Return the best record with the standard deviations of the mixture.

    Parameters
    ----------
    best : SmoothedRecord
    others : sequence of (float, SmoothedRecord)
        Weight and record of each other hypothesis.

    Returns
    -------
    SmoothedRecord
        Its item "lag" contains the difference.
    float
        Mean square of the difference of the positions [rad^2].
    """
    outputs, shares = dict(best.outputs), best.shares.copy()
    square = 0.0
    for weight, other in others:
        for name, values in best.outputs.items():
            if (std := f"{name}_std") in outputs:
                difference = other.outputs[name] - values
                if name == "theta_e":
                    difference = wrap(difference)
                    square += float(np.mean(difference**2))
                    _add_share(shares, weight * difference**2, best.model.rows_per_block)
                outputs[std] = np.sqrt(outputs[std] ** 2 + weight * difference**2)
    return replace(best, outputs=outputs, shares=shares), square


def _add_share(shares: Array, variance: Array, rows_per_block: int) -> None:
    blocks = min(len(shares), len(variance) // rows_per_block)
    whole = variance[: blocks * rows_per_block].reshape(blocks, rows_per_block)
    shares[:blocks, SHARES.index("lag")] += whole.mean(axis=1)
