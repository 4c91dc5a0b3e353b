"""Columns of a campaign's rows."""

from __future__ import annotations

from typing import Any

import polars as pl

from .specification import Specification

#: Columns of a row besides number, machine, observer and the drawn quantities; units in brackets.
MEASURES = {
    "rms": "rms position error on the scored valid rows [rad]",
    "p50": "median absolute position error on the scored valid rows [rad]",
    "p99": "99th percentile of the absolute position error on the scored valid rows [rad]",
    "worst": "largest absolute position error on the scored valid rows [rad]",
    "rms_all": "rms position error on all scored rows [rad]",
    "valid": "share of the scored rows that are valid",
    "first_valid": "time until the position is first valid [s]",
    "settled": "time until the error first stays below 10° for 50 ms [s]",
    "lost": "share of the scored valid rows with an error above 60°",
    "covered": "share of the scored valid rows with an error within two standard deviations",
    "wrong": "share of the scored valid rows that are sure and wrong: error above 5 std and 10°",
    "speed_rms": "rms error of the electrical speed on the scored valid rows [rad/s]",
    "resistance_z": "error of R at the end, in its standard deviations",
    "psi_f_z": "error of the magnet flux at the end, in its standard deviations",
    "inverter_voltage_z": "error of the inverter voltage at the end, in its standard deviations",
}
#: Further columns of a drive with its observer in the loop.
LOOP_MEASURES = {
    "handed_over": "time at which the observer first took over [s]",
    "in_loop": "share of the scored rows with the observer in the loop",
    "losses": "number of losses of the position, trips included",
    "tripped": "whether an overcurrent tripped the drive",
    "unfollowed": "share of the scored rows with a speed error above 10 % of the largest reference",
}


def schema(specification: Specification) -> dict[str, Any]:
    """Return the columns of a campaign's rows with their types."""
    columns: dict[str, Any] = {"number": pl.Int64, "machine": pl.String, "observer": pl.String}
    columns |= dict.fromkeys(specification.vary, pl.Float64)
    columns |= dict.fromkeys(MEASURES, pl.Float64)
    if specification.loop == "closed":
        columns |= dict.fromkeys(LOOP_MEASURES, pl.Float64)
        columns |= {"losses": pl.Int64, "tripped": pl.Boolean}
    return columns | {"failed": pl.String}
