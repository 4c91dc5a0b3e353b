"""The lag of the voltages, if nobody states it: hypotheses, weighed by the log.

Most drives apply a voltage one sample after the currents from which it was computed (lag -1), or
log it so that it acts from its row on (lag 0). The smoother estimates the log with both, and with
-2 and +1, which are rare; each estimate allows for a spread around its lag. The costs are the
negative logarithms of the likelihoods, and the weights follow from Bayes' rule. Where the log
cannot decide, the difference of the estimates is part of the standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.arrays import Array
from ..logs.record import signed

#: Lags to try, relative to the lag with which a log is read: 0 [samples].
LAGS = (0, -1, -2, 1)
#: Lags that are rare, and the cost of their prior: some drives compute for two samples, or log the
#: voltage that acted before its row.
UNUSUAL_LAGS, UNUSUAL_COST = (-2, 1), float(np.log(4))
#: From this weight of another lag on, the log cannot decide. The weights are calibrated: of 96
#: drives with every error at once, the wrong lag has more than 0.95 of the weight on 9 %, where
#: the other assumptions replace the lag (benchmarks/whole_log.py --unknown-lag).
UNDECIDED = 0.05
#: Least probability of a lag that texts name.
LEAST_SHARE = 0.01


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

    @property
    def alternatives(self) -> str:
        """The lags that are possible, with their probabilities, as text."""
        return " or ".join(
            f"{signed(lag)} ({share:.0%})"
            for lag, share in self.weights.items()
            if share > LEAST_SHARE
        )


def shifted(voltage: Array, shift: int) -> Array:
    """Return the voltages of the intervals if the lag is larger by `shift` samples.

    Voltages of intervals beyond the log are unknown, NaN.
    """
    if shift == 0:
        return voltage
    if shift > 0:
        return np.concatenate([voltage[shift:], np.full((shift, 2), np.nan)])
    return np.concatenate([np.full((-shift, 2), np.nan), voltage[:shift]])
