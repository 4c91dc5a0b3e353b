"""What a scenario came to: one row of numbers for each observer."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..comparison.scoring import LOST, settling_time
from ..design.drive.sensorless import RUNNING
from ..design.drive.simulate import UNFOLLOWED
from ..machines import RotatingMachine
from .observed import Found
from .simulated import Kept

Array = NDArray[np.float64]

#: A position within this many standard deviations counts as covered.
COVERED = 2.0
#: Sure and wrong: an error beyond so many standard deviations, and beyond so much [rad].
WRONG_STDS, WRONG = 5.0, np.radians(10.0)
#: Columns of a row, beyond number, machine, observer and what was drawn; units in brackets.
MEASURES = {
    "rms": "rms position error on the scored valid rows [rad]",
    "p50": "median of its size there [rad]",
    "p99": "99 % of the valid rows are within [rad]",
    "worst": "largest position error there [rad]",
    "rms_all": "rms position error on all scored rows [rad]",
    "valid": "share of the scored rows that are valid",
    "first_valid": "time until the position is first valid [s]",
    "settled": "time until the error first stays below 10° for 50 ms [s]",
    "lost": "share of the scored valid rows with an error above 60°",
    "covered": "share of the scored valid rows within two standard deviations",
    "wrong": "share of them that are sure and wrong: beyond five standard deviations and 10°",
    "speed_rms": "rms error of the electrical speed on the scored valid rows [rad/s]",
    "resistance_z": "error of R at the end, in its standard deviations",
    "psi_f_z": "error of the magnet flux at the end, in its standard deviations",
    "inverter_voltage_z": "error of the inverter's voltage at the end, in its standard deviations",
}
#: More columns of a drive with its observer in the loop.
LOOP_MEASURES = {
    "handed_over": "time at which the observer first took over [s]",
    "in_loop": "share of the scored rows in the loop",
    "losses": "how often the position was lost, a trip included",
    "tripped": "whether the current tripped the drive",
    "unfollowed": "share of the scored rows whose speed is off by a tenth of the largest reference",
}


def measures(
    t: Array,
    true: Kept,
    true_speed: Array,
    found: Found,
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
