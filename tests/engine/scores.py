"""Scores of the likelihood at the true parameters, over many drives."""

from __future__ import annotations

from ctypes import CDLL
from dataclasses import dataclass

import numpy as np

from engine.likelihood import INDEX, Array, N, Start, course_of, settled
from engine.loop import Conditions, simulated

#: Parameters whose score must have mean zero.
TESTED = (
    *("resistance", "L_d", "L_q", "psi_f", "loss", "lag", "iron_loss", "heat"),
    *("offset_alpha", "gain_re", "noise", "acceleration", "colour_gain"),
)
#: Rows until the innovations count, and the error of the course at first [rad].
SKIPPED, ERROR = 300, 0.05
#: The state at the first row is hardly known.
START = Start(4e-2, 1.8, 3e2, 0.0, 1e4, 0.05, SKIPPED)


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores (drives, parameters) and the mean information, at the true parameters."""

    scores: Array
    information: Array

    def deviation(self) -> Array:
        """Return the mean score of each tested parameter, in standard errors."""
        tested = self.scores[:, [INDEX[name] for name in TESTED]]
        return np.asarray(tested.mean(axis=0) / (tested.std(axis=0) / np.sqrt(len(tested))))

    def spread(self) -> Array:
        """Return the std of each tested score over the root of its information."""
        at = [INDEX[name] for name in TESTED]
        return np.asarray(self.scores[:, at].std(axis=0) / np.sqrt(np.diag(self.information)[at]))


def parameters_of(c: Conditions) -> Array:
    """Return the true parameters; the voltages have a constant error only."""
    p = np.zeros(N)
    given = {"resistance": c.R, "L_d": c.L_d, "L_q": c.L_q, "psi_f": c.psi, "noise": c.noise}
    given |= {"acceleration": c.acceleration, "voltage": 1e-6, "drift": 1e-3}
    given |= {"loss": 1e-6, "knee": 1.0}
    p[INDEX["colour_gain"]] = 1e-9  # not zero: the filter keeps the states of coloured noise
    if c.moving_mean == 2:  # n = (w + w before) / √2
        given["noise"] /= np.sqrt(2)
        p[INDEX["colour_gain"]] = 1.0
    for name, value in given.items():
        p[INDEX[name]] = np.log(value)
    p[INDEX["lag"]] = c.lag
    return p


def scores_at_the_truth(
    c: Conditions, drives: int, own: CDLL | None = None, seed: int = 1
) -> Scores:
    """Simulate drives, and evaluate the score of each drive."""
    record, p = simulated(c, drives, seed), parameters_of(c)
    done = []
    for k in range(drives):
        current, angle = record.current[:, k], record.angle[:, k]
        course = course_of(current, angle + ERROR, p)
        done.append(settled(record.voltage[:, k], current, c.sample_time, p, course, START, own)[0])
    information = np.mean([one.information for one in done], axis=0)
    return Scores(np.array([one.score for one in done]), np.asarray(information))
