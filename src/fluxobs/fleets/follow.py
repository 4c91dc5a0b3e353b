"""A fleet over time: parameters of every drive, their changes, trends and limits."""

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
from ..estimation.summary import si
from ..machines.heat import COPPER
from .changes import LEAST, Course, course_of

#: What is followed: its standard deviation's column, its unit, its words.
FOLLOWED = {
    "resistance": ("resistance_std", "Ω", "resistance"),
    "psi_f": ("psi_f_std", "Wb", "magnet flux"),
    "inverter_voltage": ("inverter_voltage_std", "V", "inverter's voltage loss"),
    "offset_alpha": ("offset_std", "A", "current offset α"),
    "offset_beta": ("offset_std", "A", "current offset β"),
}
#: A drive is unlike the others beyond this many standard deviations of their scatter.
UNLIKE = 5.0
#: Fewest drives among which one can be unlike the others.
FEWEST = 5
#: A value is beyond a limit if it is so by this many standard deviations.
BEYOND = 2.0
#: A trend that meets a limit within this time is told [s].
AHEAD = 5 * 365.25 * 86400

YEAR = 365.25 * 86400


@dataclass(frozen=True)
class Limit:
    """Bounds of a parameter: values, or shares of the drive's first level."""

    name: str
    low: float
    high: float
    relative: bool

    def of(self, first: float) -> tuple[float, float]:
        """The bounds of a drive that began at a level."""
        if not self.relative:
            return self.low, self.high
        low, high = sorted((first * (1 + self.low), first * (1 + self.high)))
        return low, high


def read_limit(text: str) -> Limit:
    """A limit from ``resistance=0.3..0.5``, ``psi_f=10%`` (up and down) or ``psi_f=-5..10%``.

    Raises
    ------
    UsageError
        No such parameter, or no such form.
    """
    name, _, bounds = text.partition("=")
    if name not in FOLLOWED:
        raise UsageError(f"limit {text!r}: {name!r} is not followed{nearest(name, FOLLOWED)}")
    number = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
    found = re.fullmatch(rf"(?:({number})\.\.)?({number})(%?)", bounds.strip().lstrip("±"))
    if found is None or (found[1] is None and not found[3]):
        raise UsageError(
            f"limit {text!r}: give {name}=LOW..HIGH in SI, or {name}=10% for ± 10 % of each "
            f"drive's first level"
        )
    share = 0.01 if found[3] else 1.0
    high = share * float(found[2])
    low = share * float(found[1]) if found[1] is not None else -high
    if not low < high:
        raise UsageError(f"limit {text!r}: the bounds must rise")
    return Limit(name, low, high, bool(found[3]))


@dataclass(frozen=True, eq=False)
class Followed:
    """One parameter of one drive.

    Attributes
    ----------
    drive, name : str
    times : list of datetime
    logs : list of str
    values, stds : (n,) ndarray
    course : Course
    limits : (low, high), optional
    remarks : tuple of str
        What is to be said, the most important first.
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
        """What it was at the first log."""
        return _began(np.array([when.timestamp() for when in self.times]), self.course)

    @property
    def line(self) -> Array:
        """Level of the last segment, with its trend if it has one, at all times."""
        last = self.course.segments[-1]
        t = np.array([when.timestamp() for when in self.times])
        slope = self.course.slope if self.course.drifts else 0.0
        return np.asarray(last.mean + slope * (t - np.mean(t[last.first :])))

    @property
    def level(self) -> float:
        """What it is now."""
        return float(self.line[-1])

    @property
    def unit(self) -> str:
        return FOLLOWED[self.name][1]


def _began(t: Array, course: Course) -> float:
    """Level at the first time: with one segment and a trend, where the trend began."""
    trend = course.slope if course.drifts and len(course.segments) == 1 else 0.0
    return course.segments[0].mean + trend * float(t[0] - np.mean(t))


def follow(table: pl.DataFrame, limits: Sequence[Limit] = ()) -> list[Followed]:
    """Every parameter of every drive that its logs tell at least once.

    Parameters
    ----------
    table : DataFrame
        Of :class:`fluxobs.fleets.Fleet`.
    limits : sequence of Limit
        At most one of each parameter.
    """
    by_name = {limit.name: limit for limit in limits}
    if len(by_name) < len(limits):
        raise UsageError("limits: a parameter has two; give LOW..HIGH in one")
    good = table.filter(pl.col("failed").is_null() & pl.col("time").is_not_null())
    found = []
    for name, (std, _, _) in FOLLOWED.items():
        usable = pl.col(name).is_finite() & pl.col(std).is_finite() & (pl.col(std) > 0)
        told = good.filter(usable).sort("drive", "time")
        some = [
            _followed(mine, name, std, by_name.get(name))
            for mine in told.partition_by("drive", maintain_order=True)
        ]
        found += _unlike(some)
    return sorted(found, key=lambda one: (one.drive, list(FOLLOWED).index(one.name)))


def _followed(mine: pl.DataFrame, name: str, std: str, limit: Limit | None) -> Followed:
    times: list[datetime] = mine["time"].to_list()
    t = np.array([when.timestamp() for when in times])
    values, stds = mine[name].to_numpy().astype(float), mine[std].to_numpy().astype(float)
    logs = mine["log"].to_list()
    course = course_of(t, values, stds)
    bounds = None if limit is None else limit.of(_began(t, course))
    remarks, crossed = [], False
    if bounds is not None:
        remarks = _beyond(name, logs, values, np.hypot(stds, course.scatter), bounds)
        crossed = bool(remarks)
    remarks += _jumps(name, logs, times, course)
    remarks += _trend(name, t, course, bounds)
    drive = mine["drive"][0] or ""
    return Followed(drive, name, times, logs, values, stds, course, bounds, tuple(remarks), crossed)


def _beyond(
    name: str, logs: Sequence[str], values: Array, stds: Array, bounds: tuple[float, float]
) -> list[str]:
    low, high = bounds
    out = np.flatnonzero((values < low - BEYOND * stds) | (values > high + BEYOND * stds))
    if not len(out):
        return []
    unit, words = FOLLOWED[name][1:]
    first = out[0]
    more = f", and {len(out) - 1} more" if out[1:].size else ""
    return [
        f"{words} {si(values[first], unit)} is beyond {si(low, unit)} to {si(high, unit)} in "
        f"{logs[first]}{more}"
    ]


def _jumps(name: str, logs: Sequence[str], times: Sequence[datetime], course: Course) -> list[str]:
    unit, words = FOLLOWED[name][1:]
    out = []
    for k, (first, by, std) in enumerate(course.jumps):
        before = course.segments[k].mean
        share = f" ({100 * by / before:+.1f} %)" if name != "offset_alpha" and before > 0 else ""
        heat = ""
        if name == "resistance" and before > 0:
            heat = f", as copper {by / before / COPPER:+.0f} K would"
        out.append(
            f"{words} changed by {_signed(by, unit)} ± {si(std, unit)}{share}{heat}, between "
            f"{logs[first - 1]} and {logs[first]} ({times[first]:%Y-%m-%d})"
        )
    return out


def _trend(name: str, t: Array, course: Course, bounds: tuple[float, float] | None) -> list[str]:
    if not course.drifts:
        return []
    unit, words = FOLLOWED[name][1:]
    year, std = course.slope * YEAR, course.slope_std * YEAR
    text = f"{words} drifts by {_signed(year, unit)} ± {si(std, unit)} a year"
    if bounds is None:
        return [text]
    segment = course.segments[-1]
    now = segment.mean + course.slope * (t[-1] - float(np.mean(t[segment.first :])))
    left = ((bounds[1] if course.slope > 0 else bounds[0]) - now) / course.slope
    if 0 < left < AHEAD:
        when = datetime.fromtimestamp(t[-1], UTC) + timedelta(seconds=left)
        text += f"; it meets its limit in {when:%B %Y}"
    return [text]


def _unlike(found: list[Followed]) -> list[Followed]:
    """Say which drives are unlike the others."""
    if len(found) < FEWEST:
        return found
    levels = np.array([one.level for one in found])
    middle = float(np.median(levels))
    spread = 1.4826 * float(np.median(np.abs(levels - middle)))
    out = []
    for one, level in zip(found, levels, strict=True):
        std = np.hypot(spread, one.course.segments[-1].std)
        unlike = abs(level - middle) > UNLIKE * std > 0
        if unlike and len(one.values) >= 1:
            unit, words = FOLLOWED[one.name][1:]
            text = (
                f"{words} {si(level, unit)} is unlike that of the others, {si(middle, unit)} ± "
                f"{si(spread, unit)}"
            )
            out.append(_with(one, text))
        else:
            out.append(one)
    return out


def _with(one: Followed, text: str) -> Followed:
    return replace(one, remarks=(*one.remarks, text))


def _signed(value: float, unit: str) -> str:
    return f"{'+' if value > 0 else '-'}{si(abs(value), unit)}"


def timeless(table: pl.DataFrame) -> str:
    """How many logs have no time and are left out, in words; empty if all have one."""
    count = len(table.filter(pl.col("failed").is_null() & pl.col("time").is_null()))
    if not count:
        return ""
    words = "log has no time and is" if count == 1 else "logs have no time and are"
    return f"{count} {words} left out: put the date into the name, 2024-05-17."


def untold(found: Sequence[Followed], limits: Sequence[Limit]) -> list[str]:
    """Limits of which no log tells whether they hold, in words."""
    told = {one.name for one in found}
    return [
        f"limit on {FOLLOWED[limit.name][2]}: no log tells it"
        for limit in limits
        if limit.name not in told
    ]


def enough(table: pl.DataFrame) -> str:
    """What keeps changes from being found, in words; empty if nothing does."""
    logs = table.filter(pl.col("failed").is_null())
    most = int(logs.group_by("drive").len()["len"].max() or 0) if len(logs) else 0  # type: ignore[arg-type]
    if most >= 2 * LEAST:
        return ""
    return (
        f"No drive has more than {most} logs; changes need {2 * LEAST}. Do all logs of one folder "
        f"belong to one drive? `fluxobs estimate … --drive` says otherwise."
    )
