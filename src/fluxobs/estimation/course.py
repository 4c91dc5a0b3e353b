"""The course of the learnt parameters over a long log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..core.arrays import Array
from ..smoothing.assumptions import NAMES
from ..smoothing.record import Assumed, SmoothingModel

#: A segment with a larger misfit did not converge and teaches nothing.
CONVERGED_MISFIT = 0.3
#: Parameters that change with temperature change by at most this share of their prior.
LARGEST_CHANGE = 1.0


@dataclass(frozen=True, eq=False)
class Learning:
    """What a segment of a log taught.

    Attributes
    ----------
    time : float
        Middle of the segment [s].
    assumed : Assumed
    misfit : float
        Mean square of the normalised innovations.
    """

    time: float
    assumed: Assumed
    misfit: float


@dataclass(frozen=True, eq=False)
class Course:
    """Parameters over the time of a log.

    Attributes
    ----------
    times : (n,) ndarray
        [s].
    values : (n, active) ndarray
    covariances : (n, active, active) ndarray
    filter_scale : float
    misfit : float
        Median over the segments.
    """

    times: Array
    values: Array
    covariances: Array
    filter_scale: float
    misfit: float

    def at(self, time: float, model: SmoothingModel) -> Assumed:
        """Return the parameters at a time [s]."""
        if not len(self.times):
            return model.prior()
        deviations = dict.fromkeys(NAMES, 0.0)
        for n, name in enumerate(model.active):
            deviations[name] = float(np.interp(time, self.times, self.values[:, n]))
        nearest = int(np.argmin(np.abs(self.times - time)))
        return Assumed(deviations, self.covariances[nearest], self.filter_scale)


def no_course() -> Course:
    """Return the course of a log that taught nothing."""
    return Course(np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0, 0)), 1.0, float("nan"))


def course_of(model: SmoothingModel, learnings: Sequence[Learning]) -> Course:
    """Join what segments taught: Kalman filter and smoother of parameters that walk.

    Magnet flux and resistance walk with the rates of the model, the others stay.
    """
    good = [one for one in learnings if one.misfit < CONVERGED_MISFIT] or list(learnings)
    names = model.active
    prior = np.diag([model.stds[name] ** 2 for name in names])
    times = np.array([one.time for one in good])
    scale = float(np.median([one.assumed.filter_scale for one in good]))
    misfit = float(np.median([one.misfit for one in learnings]))
    if len(good) == 1:
        value = np.array([[good[0].assumed.deviations[name] for name in names]])
        return Course(times, value, good[0].assumed.covariance[None], scale, misfit)
    rate = np.array([_rate(model, name) for name in names])
    limit = LARGEST_CHANGE * np.diag(prior)
    precision = np.linalg.inv(prior)
    x, P = np.zeros(len(names)), prior
    filtered, predicted = [], []
    for n, one in enumerate(good):
        if n > 0:
            P = P + np.diag(np.minimum(rate**2 * (times[n] - times[n - 1]), limit))
        predicted.append((x, P))
        posterior = np.linalg.inv(one.assumed.covariance)
        information = posterior - precision  # what the segment itself tells
        value = np.array([one.assumed.deviations[name] for name in names])
        before = np.linalg.inv(P)
        P = np.linalg.inv(before + information)
        P = (P + P.T) / 2
        x = P @ (before @ x + posterior @ value)
        filtered.append((x, P))
    smoothed = [filtered[-1]]
    for n in range(len(good) - 2, -1, -1):
        gain = filtered[n][1] @ np.linalg.inv(predicted[n + 1][1])
        x = filtered[n][0] + gain @ (smoothed[0][0] - predicted[n + 1][0])
        P = filtered[n][1] + gain @ (smoothed[0][1] - predicted[n + 1][1]) @ gain.T
        smoothed.insert(0, (x, P))
    return Course(
        times,
        np.stack([x for x, _ in smoothed]),
        np.stack([P for _, P in smoothed]),
        scale,
        misfit,
    )


def _rate(model: SmoothingModel, name: str) -> float:
    """Return the standard deviation of a parameter's change in a second."""
    numbers = model.numbers
    if name == "resistance":
        return numbers["resistance_rate"] * numbers["resistance"]
    if name == "psi_f":
        return numbers["psi_rate"] * numbers["flux_base"]
    return 0.0
