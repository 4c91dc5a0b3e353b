"""Scores of an observer: the errors that matter to a drive engineer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.arrays import Array
from ..machines import RotatingMachine

#: Settled: the error stays below SETTLED [rad] for HELD [s]. Lost: the error exceeds LOST [rad].
SETTLED, HELD, LOST = np.radians(10.0), 0.05, np.radians(60.0)


@dataclass(frozen=True, eq=False)
class Truth:
    """Reference values for scoring; speed and flux are None where unknown."""

    t: Array
    theta_e: Array
    speed_e: Array | None
    flux: NDArray[np.complex128] | None
    score_from: float
    machine: RotatingMachine


@dataclass(frozen=True)
class Score:
    """Errors of one observer on one record.

    Attributes
    ----------
    rms, worst : float
        Rms and largest absolute position error from `score_from` on [rad].
    speed : float or None
        Rms error of the electrical speed [rad/s].
    flux : float or None
        Rms flux error [Wb].
    settled : float
        Time from which the error first stays below 10° for 50 ms [s]; nan if never.
    lost : float
        Share of the scored rows with an error above 60°.
    claimed : float
        Share of the scored rows that the observer marks as valid.
    worst_claimed : float
        Largest absolute position error on the scored valid rows [rad].
    rms_claimed : float
        Rms position error on the scored valid rows [rad]; nan if there are none.
    """

    rms: float
    worst: float
    speed: float | None
    flux: float | None
    settled: float
    lost: float
    claimed: float = 1.0
    worst_claimed: float = 0.0
    rms_claimed: float = float("nan")


def scored_error(estimated: Array, truth: Truth) -> Array:
    """Return the position error [rad]; an estimate that is not finite counts as half a turn."""
    finite = np.where(np.isfinite(estimated), estimated, truth.theta_e + np.pi)
    return truth.machine.position_error(finite, truth.theta_e)


def settling_time(t: Array, error: Array) -> float:
    """Return when an absolute error first stays below 10° for 50 ms [s]; nan if never."""
    samples = max(1, round(HELD / (t[1] - t[0])))
    count = np.concatenate([[0], np.cumsum(error < SETTLED)])
    stays = count[samples:] - count[:-samples] == samples
    return float(t[np.argmax(stays)]) if stays.any() else float("nan")


def true_speed(
    machine: RotatingMachine, theta_e: ArrayLike, speed: ArrayLike, sample_time: float
) -> Array:
    """Return the electrical speed of the position [rad/s].

    For a cage, the speed is the derivative of the position, the angle of the rotor flux. For other
    machines, it is computed from the mechanical speed.
    """
    if not machine.flux_moves:
        return machine.n_p * np.asarray(speed, float)
    return np.asarray(np.gradient(np.unwrap(np.asarray(theta_e, float)), sample_time), float)


def score(
    theta_e: Array,
    speed_e: Array,
    flux: NDArray[np.complex128],
    truth: Truth,
    valid: NDArray[np.bool_] | None = None,
) -> Score:
    """Score estimates, one row per sample; give `valid` if the observer reports it."""
    error = np.abs(scored_error(theta_e, truth))
    scored = truth.t >= truth.score_from
    claimed = np.ones(len(error), bool) if valid is None else valid

    def rms(difference: NDArray[np.complex128] | Array) -> float:
        return float(np.sqrt(np.mean(np.abs(difference[scored]) ** 2)))

    return Score(
        float(np.sqrt(np.mean(error[scored] ** 2))),
        float(error[scored].max()),
        None if truth.speed_e is None else rms(speed_e - truth.speed_e),
        None if truth.flux is None else rms(flux - truth.flux),
        settling_time(truth.t, error),
        float(np.mean(error[scored] > LOST)),
        float(np.mean(claimed[scored])),
        float(error[scored & claimed].max(initial=0.0)),
        float(np.sqrt(np.mean(error[scored & claimed] ** 2)))
        if (scored & claimed).any()
        else float("nan"),
    )
