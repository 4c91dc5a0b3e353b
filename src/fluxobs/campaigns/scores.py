"""What a scenario came to: one row of numbers for each observer."""

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
from .simulated import Kept

#: A position within this many standard deviations counts as covered.
COVERED = 2.0
#: Sure and wrong: an error beyond so many standard deviations, and beyond so much [rad].
WRONG_STDS, WRONG = 5.0, np.radians(10.0)


def measures(
    t: Array,
    true: Kept,
    true_speed: Array,
    found: ObservedRecord,
    machine: RotatingMachine,
    score_from: float,
) -> dict[str, Any]:
    """The measures of one observer on one record; None where nothing can be told."""
    wild = ~np.isfinite(found.theta_e)
    theta = np.where(wild, true.theta_e + np.pi, found.theta_e)
    error = np.abs(machine.position_error(theta, true.theta_e))
    scored = t >= score_from
    rows = scored & found.valid
    off = error[rows]
    settled = settling_time(t, error)
    out: dict[str, Any] = dict.fromkeys(MEASURES)
    out |= {
        "rms_all": _rms(error[scored]),
        "valid": float(np.mean(found.valid[scored])),
        "first_valid": float(t[np.argmax(found.valid)]) if found.valid.any() else None,
        "settled": settled if np.isfinite(settled) else None,
    }
    out |= {f"{name}_z": value for name, value in found.errors.items()}
    if not len(off):
        return out
    out |= {
        "rms": _rms(off),
        "p50": float(np.median(off)),
        "p99": float(np.quantile(off, 0.99)),
        "worst": float(off.max()),
        "lost": float(np.mean(off > LOST)),
        "speed_rms": _rms(np.nan_to_num(found.speed_e)[rows] - true_speed[rows]),
    }
    if found.theta_e_std is not None:
        std = found.theta_e_std[rows]
        out["covered"] = float(np.mean(off <= COVERED * std))
        out["wrong"] = float(np.mean((off > WRONG_STDS * std) & (off > WRONG)))
    return out


def loop_measures(t: Array, trace: Kept, score_from: float) -> dict[str, Any]:
    """The measures of a drive with its observer in the loop."""
    scored, running = t >= score_from, trace.mode == RUNNING
    largest = np.abs(trace.reference).max()
    off = np.abs(trace.speed - trace.reference) > UNFOLLOWED * largest
    tripped = bool(trace.tripped.any())
    return {
        "handed_over": float(t[np.argmax(running)]) if running.any() else None,
        "in_loop": float(np.mean(running[scored])),
        "losses": int(np.sum(np.diff(trace.mode) < 0)) + tripped,
        "tripped": tripped,
        "unfollowed": float(np.mean(off[scored])) if largest > 0 else 0.0,
    }


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(error**2)))
