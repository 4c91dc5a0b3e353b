"""Scores of the likelihood at the true parameters, over many drives."""

from __future__ import annotations

from ctypes import CDLL
from dataclasses import dataclass

import numpy as np

from engine.likelihood import INDEX, Array, N, Start, likelihood
from engine.loop import SPEED, Conditions, Record, simulated

#: Parameters whose score must have mean zero.
TESTED = (
    *("resistance", "L_d", "L_q", "psi_f", "loss", "lag"),
    *("noise", "acceleration", "colour_gain"),
)
SKIPPED = 300


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
    given |= {"gain": 1e-6, "knee": 1.0}
    if c.moving_mean == 2:  # n = (w + w before) / √2
        given["noise"] /= np.sqrt(2)
        p[INDEX["colour_gain"]] = 1.0
    for name, value in given.items():
        p[INDEX[name]] = np.log(value)
    p[INDEX["lag"]] = c.lag
    return p


def starts(record: Record, drift: float, seed: int = 5) -> list[Start]:
    """Return a start near each true angle, with its standard deviation."""
    rng = np.random.default_rng(seed)
    return [
        Start(
            angle=first + 0.03 * rng.standard_normal(),
            angle_std=0.03,
            speed=SPEED + 10.0 * rng.standard_normal(),
            speed_std=10.0,
            flux_std=4e-4,
            drift_std=drift,
            acceleration_std=0.0,
            gain_std=0.0,
            skipped=SKIPPED,
        )
        for first in record.angle[0]
    ]


def scores_at_the_truth(
    c: Conditions, drives: int, own: CDLL | None = None, seed: int = 1
) -> Scores:
    """Simulate drives, and evaluate the score of each drive."""
    record = simulated(c, drives, seed)
    begin, p = starts(record, c.drift), parameters_of(c)
    done = [
        likelihood(record.voltage[:, k], record.current[:, k], c.sample_time, p, begin[k], own=own)
        for k in range(drives)
    ]
    information = np.mean([one.information for one in done], axis=0)
    return Scores(np.array([one.score for one in done]), np.asarray(information))
