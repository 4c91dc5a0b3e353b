"""Columns of a campaign's rows."""

from __future__ import annotations

from typing import Any

import polars as pl

from .specification import Specification

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


def schema(specification: Specification) -> dict[str, Any]:
    """Columns of a campaign's rows."""
    columns: dict[str, Any] = {"number": pl.Int64, "machine": pl.String, "observer": pl.String}
    columns |= dict.fromkeys(specification.vary, pl.Float64)
    columns |= dict.fromkeys(MEASURES, pl.Float64)
    if specification.loop == "closed":
        columns |= dict.fromkeys(LOOP_MEASURES, pl.Float64)
        columns |= {"losses": pl.Int64, "tripped": pl.Boolean}
    return columns | {"failed": pl.String}
