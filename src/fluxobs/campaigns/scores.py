"""Scores of a scenario: one row of numbers for each observer."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..comparison.scoring import LOST, settling_time
from ..core.arrays import Array
from ..machines import RotatingMachine
from ..simulation.drive.sensorless import RUNNING
from ..simulation.drive.simulate import UNFOLLOWED
from .columns import MEASURES
from .observed import ObservedRecord
from .simulated import ScoredTrace

#: A position error within this many standard deviations counts as covered.
COVERED = 2.0
#: Sure and wrong: the error exceeds this many standard deviations and this angle [rad].
WRONG_STDS, WRONG = 5.0, np.radians(10.0)


def measures(
    t: Array,
    trace: ScoredTrace,
    true_speed: Array,
    record: ObservedRecord,
    machine: RotatingMachine,
    score_from: float,
) -> dict[str, Any]:
    """Return the scores of one observer on one record; None where undefined."""
    not_finite = ~np.isfinite(record.theta_e)
    theta = np.where(not_finite, trace.theta_e + np.pi, record.theta_e)
    errors = np.abs(machine.position_error(theta, trace.theta_e))
    scored = t >= score_from
    scored_valid = scored & record.valid
    valid_errors = errors[scored_valid]
    settled = settling_time(t, errors)
    scores: dict[str, Any] = dict.fromkeys(MEASURES)
    scores |= {
        "rms_all": _rms(errors[scored]),
        "valid": float(np.mean(record.valid[scored])),
        "first_valid": float(t[np.argmax(record.valid)]) if record.valid.any() else None,
        "settled": settled if np.isfinite(settled) else None,
    }
    scores |= {f"{name}_z": value for name, value in record.errors.items()}
    if not len(valid_errors):
        return scores
    scores |= {
        "rms": _rms(valid_errors),
        "p50": float(np.median(valid_errors)),
        "p99": float(np.quantile(valid_errors, 0.99)),
        "worst": float(valid_errors.max()),
        "lost": float(np.mean(valid_errors > LOST)),
        "speed_rms": _rms(np.nan_to_num(record.speed_e)[scored_valid] - true_speed[scored_valid]),
    }
    if record.theta_e_std is not None:
        std = record.theta_e_std[scored_valid]
        scores["covered"] = float(np.mean(valid_errors <= COVERED * std))
        scores["wrong"] = float(np.mean((valid_errors > WRONG_STDS * std) & (valid_errors > WRONG)))
    return scores


def loop_measures(t: Array, trace: ScoredTrace, score_from: float) -> dict[str, Any]:
    """Return the scores of a drive with its observer in the loop."""
    scored, running = t >= score_from, trace.mode == RUNNING
    largest_reference = np.abs(trace.reference).max()
    unfollowed = np.abs(trace.speed - trace.reference) > UNFOLLOWED * largest_reference
    tripped = bool(trace.tripped.any())
    return {
        "handed_over": float(t[np.argmax(running)]) if running.any() else None,
        "in_loop": float(np.mean(running[scored])),
        "losses": int(np.sum(np.diff(trace.mode) < 0)) + tripped,
        "tripped": tripped,
        "unfollowed": float(np.mean(unfollowed[scored])) if largest_reference > 0 else 0.0,
    }


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(error**2)))
