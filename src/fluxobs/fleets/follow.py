"""A fleet over time: the parameters of each drive, their changes, trends and limits."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta

import numpy as np
import polars as pl

from ..core.arrays import Array
from ..core.validation import nearest
from ..errors import UsageError
from ..machines.heat import COPPER
from ..presentation.summary import si
from .changes import LEAST, Course, course_of

#: Followed parameters: column of the standard deviation, unit, label.
FOLLOWED = {
    "resistance": ("resistance_std", "Ω", "resistance"),
    "psi_f": ("psi_f_std", "Wb", "magnet flux"),
    "inverter_voltage": ("inverter_voltage_std", "V", "inverter's voltage loss"),
    "offset_alpha": ("offset_std", "A", "current offset α"),
    "offset_beta": ("offset_std", "A", "current offset β"),
}
#: A drive differs from the other drives beyond this many standard deviations of their scatter.
UNLIKE = 5.0
#: Smallest number of drives for this comparison.
FEWEST = 5
#: A value crosses a limit when it is this many standard deviations beyond the limit.
BEYOND = 2.0
#: A remark states when a trend will reach a limit, if the trend does so within this time [s].
AHEAD = 5 * 365.25 * 86400

YEAR = 365.25 * 86400


@dataclass(frozen=True)
class Limit:
    """Bounds of a parameter: absolute, or relative to the drive's first level."""

    name: str
    low: float
    high: float
    relative: bool

    def of(self, first_level: float) -> tuple[float, float]:
        """Return the bounds of a drive with this first level."""
        if not self.relative:
            return self.low, self.high
        lower, upper = sorted((first_level * (1 + self.low), first_level * (1 + self.high)))
        return lower, upper


def read_limit(text: str) -> Limit:
    """Read a limit: ``resistance=0.3..0.5``, ``psi_f=10%`` (up and down) or ``psi_f=-5..10%``.

    Raises
    ------
    UsageError
        The parameter is unknown, or the text is malformed.
    """
    name, _, bounds = text.partition("=")
    if name not in FOLLOWED:
        raise UsageError(f"limit {text!r}: {name!r} is not followed{nearest(name, FOLLOWED)}")
    number = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
    match = re.fullmatch(rf"(?:({number})\.\.)?({number})(%?)", bounds.strip().lstrip("±"))
    if match is None or (match[1] is None and not match[3]):
        raise UsageError(
            f"limit {text!r}: give {name}=LOW..HIGH in SI, or {name}=10% for ±10 % of each drive's "
            f"first level"
        )
    share = 0.01 if match[3] else 1.0
    upper = share * float(match[2])
    lower = share * float(match[1]) if match[1] is not None else -upper
    if not lower < upper:
        raise UsageError(f"limit {text!r}: LOW must be below HIGH")
    return Limit(name, lower, upper, bool(match[3]))


@dataclass(frozen=True, eq=False)
class Followed:
    """One parameter of one drive over time.

    Attributes
    ----------
    drive, name : str
    times : list of datetime
    logs : list of str
    values, stds : (n,) ndarray
    course : Course
    limits : (low, high), optional
    remarks : tuple of str
        Sentences on limits, changes, trends and differences, in this order.
    crossed : bool
        Whether a limit is crossed.
    """

    drive: str
    name: str
    times: list[datetime]
    logs: list[str]
    values: Array
    stds: Array
    course: Course
    limits: tuple[float, float] | None
    remarks: tuple[str, ...]
    crossed: bool

    @property
    def first(self) -> float:
        """Level at the first log."""
        return _first_level(np.array([time.timestamp() for time in self.times]), self.course)

    @property
    def line(self) -> Array:
        """Level of the last segment, with its trend if significant, at all times."""
        segment = self.course.segments[-1]
        t = np.array([time.timestamp() for time in self.times])
        slope = self.course.slope if self.course.drifts else 0.0
        return np.asarray(segment.mean + slope * (t - np.mean(t[segment.first :])))

    @property
    def level(self) -> float:
        """Level at the last log."""
        return float(self.line[-1])

    @property
    def unit(self) -> str:
        return FOLLOWED[self.name][1]


def _first_level(t: Array, course: Course) -> float:
    """Return the level at the first time, taken from the trend if it covers the whole series."""
    trend = course.slope if course.drifts and len(course.segments) == 1 else 0.0
    return course.segments[0].mean + trend * float(t[0] - np.mean(t))


def follow(table: pl.DataFrame, limits: Sequence[Limit] = ()) -> list[Followed]:
    """Follow each parameter of each drive that at least one log of the drive identifies.

    Parameters
    ----------
    table : DataFrame
        Table of :class:`fluxobs.fleets.Fleet`.
    limits : sequence of Limit
        At most one limit per parameter.
    """
    by_name = {limit.name: limit for limit in limits}
    if len(by_name) < len(limits):
        raise UsageError("limits: a parameter has two limits; give one LOW..HIGH")
    usable_logs = table.filter(pl.col("failed").is_null() & pl.col("time").is_not_null())
    all_followed = []
    for name, (std, _, _) in FOLLOWED.items():
        has_value = pl.col(name).is_finite() & pl.col(std).is_finite() & (pl.col(std) > 0)
        logs_with_value = usable_logs.filter(has_value).sort("drive", "time")
        followed = [
            _follow_drive(drive_logs, name, std, by_name.get(name))
            for drive_logs in logs_with_value.partition_by("drive", maintain_order=True)
        ]
        all_followed += _mark_unlike(followed)
    names = list(FOLLOWED)
    return sorted(all_followed, key=lambda item: (item.drive, names.index(item.name)))


def _follow_drive(drive_logs: pl.DataFrame, name: str, std: str, limit: Limit | None) -> Followed:
    times: list[datetime] = drive_logs["time"].to_list()
    t = np.array([time.timestamp() for time in times])
    values, stds = (
        drive_logs[name].to_numpy().astype(float),
        drive_logs[std].to_numpy().astype(float),
    )
    logs = drive_logs["log"].to_list()
    course = course_of(t, values, stds)
    bounds = None if limit is None else limit.of(_first_level(t, course))
    remarks, crossed = [], False
    if bounds is not None:
        remarks = _limit_remarks(name, logs, values, np.hypot(stds, course.scatter), bounds)
        crossed = bool(remarks)
    remarks += _jump_remarks(name, logs, times, course)
    remarks += _trend_remarks(name, t, course, bounds)
    drive = drive_logs["drive"][0] or ""
    return Followed(drive, name, times, logs, values, stds, course, bounds, tuple(remarks), crossed)


def _limit_remarks(
    name: str, logs: Sequence[str], values: Array, stds: Array, bounds: tuple[float, float]
) -> list[str]:
    lower, upper = bounds
    outside = np.flatnonzero((values < lower - BEYOND * stds) | (values > upper + BEYOND * stds))
    if not len(outside):
        return []
    unit, label = FOLLOWED[name][1:]
    first = outside[0]
    more = len(outside) - 1
    others = f" and {more} more log{'' if more == 1 else 's'}" if more else ""
    return [
        f"{label} {si(values[first], unit)} is outside {si(lower, unit)} to {si(upper, unit)} in "
        f"{logs[first]}{others}"
    ]


def _jump_remarks(
    name: str, logs: Sequence[str], times: Sequence[datetime], course: Course
) -> list[str]:
    unit, label = FOLLOWED[name][1:]
    remarks = []
    for k, (index, change, change_std) in enumerate(course.jumps):
        before = course.segments[k].mean
        share = (
            f" ({100 * change / before:+.1f} %)" if name != "offset_alpha" and before > 0 else ""
        )
        temperature = ""
        if name == "resistance" and before > 0:
            temperature = f", like {change / before / COPPER:+.0f} K of copper"
        remarks.append(
            f"{label} changed by {_signed(change, unit)} ± {si(change_std, unit)}{share}"
            f"{temperature}, between {logs[index - 1]} and {logs[index]} "
            f"({times[index]:%Y-%m-%d})"
        )
    return remarks


def _trend_remarks(
    name: str, t: Array, course: Course, bounds: tuple[float, float] | None
) -> list[str]:
    if not course.drifts:
        return []
    unit, label = FOLLOWED[name][1:]
    slope, slope_std = course.slope * YEAR, course.slope_std * YEAR
    text = f"{label} drifts by {_signed(slope, unit)} ± {si(slope_std, unit)} per year"
    if bounds is None:
        return [text]
    segment = course.segments[-1]
    level = segment.mean + course.slope * (t[-1] - float(np.mean(t[segment.first :])))
    remaining = ((bounds[1] if course.slope > 0 else bounds[0]) - level) / course.slope
    if 0 < remaining < AHEAD:
        date = datetime.fromtimestamp(t[-1], UTC) + timedelta(seconds=remaining)
        text += f"; it will reach the limit in {date:%B %Y}"
    return [text]


def _mark_unlike(followed: list[Followed]) -> list[Followed]:
    """Add a remark to drives that differ from the other drives."""
    if len(followed) < FEWEST:
        return followed
    levels = np.array([item.level for item in followed])
    median = float(np.median(levels))
    spread = 1.4826 * float(np.median(np.abs(levels - median)))
    remarked = []
    for item, level in zip(followed, levels, strict=True):
        std = np.hypot(spread, item.course.segments[-1].std)
        unlike = abs(level - median) > UNLIKE * std > 0
        if unlike and len(item.values) >= 1:
            unit, label = FOLLOWED[item.name][1:]
            remark = (
                f"{label} {si(level, unit)} differs from the other drives ({si(median, unit)} ± "
                f"{si(spread, unit)})"
            )
            remarked.append(replace(item, remarks=(*item.remarks, remark)))
        else:
            remarked.append(item)
    return remarked


def _signed(value: float, unit: str) -> str:
    return f"{'+' if value > 0 else '-'}{si(abs(value), unit)}"


def describe_undated(table: pl.DataFrame) -> str:
    """Describe the logs that are ignored because they have no time; empty if there are none."""
    count = len(table.filter(pl.col("failed").is_null() & pl.col("time").is_null()))
    if not count:
        return ""
    subject = "log has no time and is" if count == 1 else "logs have no time and are"
    return f"{count} {subject} ignored: write a date like 2024-05-17 into the name."


def untold(followed: Sequence[Followed], limits: Sequence[Limit]) -> list[str]:
    """List the limits on parameters that no log identifies."""
    names = {item.name for item in followed}
    return [
        f"limit on {FOLLOWED[limit.name][2]}: no log identifies this parameter"
        for limit in limits
        if limit.name not in names
    ]


def describe_too_few(table: pl.DataFrame) -> str:
    """Explain that too few logs per drive exist to find changes; empty if there are enough."""
    logs = table.filter(pl.col("failed").is_null())
    largest = int(logs.group_by("drive").len()["len"].max() or 0) if len(logs) else 0  # type: ignore[arg-type]
    if largest >= 2 * LEAST:
        return ""
    return (
        f"No drive has more than {largest} logs; finding changes needs {2 * LEAST} logs. If the "
        "logs of a folder belong to several drives, give `fluxobs estimate … --drive`."
    )
