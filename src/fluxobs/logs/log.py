"""A log: a table and the meaning of its columns, read as aligned currents and voltages."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import RecordError
from ..model.frames import alphabeta_current, native_voltage, rotate, wrap
from ..model.held import Held
from ..model.inverter import InverterError
from .formats import BATCH, Table, missing_column, read_rows
from .formats.table import Columns
from .layout import Layout
from .record import Record, check_lag, interval_rows

Array = NDArray[np.float64]

MINIMUM_ROWS = 20
#: Largest deviation of a time step from the sample time, as a share of it.
TIME_TOLERANCE = 0.1
#: The same if the user gave the sample time: t may be rounded, but no sample may be missing.
TIME_TOLERANCE_GIVEN = 0.9
_HEAD = 65536


class Aligned(NamedTuple):
    """Rows of a log: time [s], current now, mean voltage over the interval ending now, and the
    scaled truth channel: an electrical or mechanical angle [rad], or a position [m].
    """

    t: Array
    current: Array
    voltage: Array
    truth: Array | None


# Time, current, angle in the middle of the interval ending now (frame dq), truth.
_Piece = tuple[Array, Array, Array | None, Array | None]


def _join(one: _Piece | None, other: _Piece) -> _Piece:
    if one is None or len(one[0]) == 0:
        return other
    (t0, i0, m0, h0), (t1, i1, m1, h1) = one, other
    return (
        np.concatenate([t0, t1]),
        np.concatenate([i0, i1]),
        None if m0 is None or m1 is None else np.concatenate([m0, m1]),
        None if h0 is None or h1 is None else np.concatenate([h0, h1]),
    )


def _split(piece: _Piece, at: int) -> tuple[_Piece, _Piece]:
    t, i, m, h = piece
    return (
        (t[:at], i[:at], None if m is None else m[:at], None if h is None else h[:at]),
        (t[at:], i[at:], None if m is None else m[at:], None if h is None else h[at:]),
    )


def _align(piece: _Piece, source: Array, lag: float, first: int, held: int) -> Aligned:
    t, current, middle, truth = piece
    voltage = interval_rows(source, lag, first, first + len(t), held)
    return Aligned(t, current, voltage if middle is None else rotate(voltage, middle), truth)


@dataclass(frozen=True, eq=False)
class Log:
    """A table and its layout, checked; rows first … last - 1 are read. Made by :func:`open_log`."""

    table: Table
    layout: Layout
    names: dict[str, str]  # channel → column
    sample_time: float
    t0: float
    first: int
    last: int
    inverter: InverterError | None = None  # subtracted from the commanded voltage

    def __len__(self) -> int:
        return self.last - self.first

    def __repr__(self) -> str:
        return f"<Log: {self.path.name}, {len(self)} rows, {self.sample_time:g} s apart>"

    @property
    def path(self) -> Path:
        """Path of the file; for arrays, a name that stands for them."""
        return self.table.path

    @property
    def truth(self) -> tuple[str, str] | None:
        """Channel and column of the truth, if there is one."""
        return next(iter(self.layout.truth.items()), None)

    @property
    def held(self) -> Held:
        """Whether its voltages are held over a sample (:mod:`fluxobs.model.held`)."""
        if self.layout.held is not None:
            return self.layout.held
        return "auto" if self.layout.lag == round(self.layout.lag) else False

    def less_inverter(self, inverter: InverterError | None) -> Log:
        """The same log, with the inverter's error subtracted from its commanded voltages."""
        return replace(self, inverter=inverter)

    def lagged(self, by: float) -> Log:
        """The same log, with voltages that act `by` samples earlier."""
        return replace(self, layout=self.layout.model_copy(update={"lag": self.layout.lag + by}))

    def _columns(self) -> list[str]:
        names = list(self.names.values())
        return [*names, self.truth[1]] if self.truth is not None else names

    def _scaled(self, channel: str, values: Array) -> Array:
        scale, offset = self.layout.scale.get(channel), self.layout.offset.get(channel)
        values = values if scale is None else values * scale
        return values if offset is None else values + offset

    def _channels(self, part: Columns) -> Columns:
        channels = {name: self._scaled(name, part[column]) for name, column in self.names.items()}
        if self.layout.frame == "duty" and self.layout.udc is not None:
            link = np.full(len(next(iter(channels.values()))), self.layout.udc)
            channels["udc"] = self._scaled("udc", link)
        return channels

    def _truth(self, part: Columns) -> Array | None:
        if self.truth is None:
            return None
        channel, column = self.truth
        return self._scaled(channel, part[column])

    def channels(self, first: int, last: int) -> Iterator[Columns]:
        """Yield rows of the channels, scaled, before any transform; "truth" is the true angle."""
        for part in self.table.batches(self._columns(), first, last, BATCH):
            channels, truth = self._channels(part), self._truth(part)
            yield channels if truth is None else channels | {"truth": truth}

    def _time(self, channels: Columns, row: int, count: int) -> Array:
        if "t" in channels:
            return channels["t"]
        return np.asarray(np.arange(row, row + count) * self.sample_time)

    def aligned(
        self, first: int | None = None, last: int | None = None, size: int = BATCH
    ) -> Iterator[Aligned]:
        """Yield rows in order, less the inverter's loss; the batch size changes no number.

        Raises
        ------
        RecordError
            A value is not a number, or time does not advance uniformly; the message says where.
        """
        before: Array | None = None
        for part in self._as_commanded(first, last, size):
            if self.inverter is None:
                yield part
                continue
            joined = np.concatenate([part.current[:1] if before is None else before, part.current])
            before = part.current[-1:]
            lost = self.inverter.lost(joined[:-1], joined[1:])
            yield part._replace(voltage=part.voltage - lost)

    def _as_commanded(self, first: int | None, last: int | None, size: int) -> Iterator[Aligned]:
        first = self.first if first is None else first
        last = self.last if last is None else last
        lag = self.layout.lag
        source = np.empty((0, 2))  # voltages as recorded, rows held … row - 1
        held = emitted = row = first
        waiting: _Piece | None = None  # rows whose voltage may not have been read yet
        previous_t = previous_angle = np.nan
        for part in self.table.batches(self._columns(), first, last, size):
            channels = self._channels(part)
            count = len(next(iter(channels.values())))
            t = self._time(channels, row, count)
            if "t" in channels:
                self._check_time(np.r_[previous_t, t], row - 1)
                previous_t = float(t[-1])
            middle = None
            if self.layout.frame == "dq":
                angle = np.r_[previous_angle, channels["theta_e"]]
                middle = angle[:-1] + wrap(np.diff(angle)) / 2
                previous_angle = float(angle[-1])
            source = np.concatenate([source, native_voltage(self.layout.frame, channels)])
            row += count
            current = alphabeta_current(self.layout.frame, channels)
            waiting = _join(waiting, (t, current, middle, self._truth(part)))
            # Row k needs the voltage row at or above k - 1 + lag.
            ready = min(row, row - int(np.ceil(lag - 1)))
            if ready > emitted:
                done, waiting = _split(waiting, ready - emitted)
                yield _align(done, source, lag, emitted, held)
                emitted = ready
            keep = min(max(held, emitted - 1 + int(np.floor(lag))), row)
            source, held = source[keep - held :], keep
        if waiting is not None and row > emitted:
            yield _align(waiting, source, lag, emitted, held)

    def _check_time(self, t: Array, row: int) -> None:
        """Check that time is uniform. `t` begins at `row`; its first value is NaN at the start."""
        step = np.diff(t)
        known = np.isfinite(t[1:])
        if not known.all():
            at = row + 1 + int(np.argmin(known))
            raise RecordError(
                f"{self.table.path}, {self.table.place(at)}: t is missing. If the samples "
                f"are uniform, --sample-time and --column t=- ignore t"
            )
        step = np.where(np.isnan(step), self.sample_time, step)
        if (step <= 0).any():
            at = int(np.argmax(step <= 0))
            raise RecordError(
                f"{self.table.path}, {self.table.place(row + 1 + at)}: time runs backwards or "
                f"stands still, {t[at]:.9g} s then {t[at + 1]:.9g} s. Cut the log there; if the "
                f"samples are uniform, --sample-time and --column t=- ignore t"
            )
        given = self.layout.sample_time is not None
        tolerance = TIME_TOLERANCE_GIVEN if given else TIME_TOLERANCE
        deviation = np.abs(step / self.sample_time - 1)
        at = int(np.argmax(deviation))
        if deviation[at] > tolerance:
            raise RecordError(
                f"{self.table.path}, {self.table.place(row + 1 + at)}: samples are not uniform: a "
                f"step of {step[at]:.6g} s where {self.sample_time:.6g} s is expected (the worst "
                f"place; {tolerance:.0%} is tolerated). Fill gaps with empty rows; if t is "
                f"only rounded, --sample-time and --column t=- ignore it"
            )

    def to_record(self) -> Record:
        """The whole log in memory; its voltages are aligned, so its lag is 0."""
        parts = list(self.aligned())
        voltage = np.concatenate([part.voltage for part in parts])
        return Record(
            self.sample_time,
            # Row k of the record acts from t_k on, so the interval ending at k goes to row k - 1.
            np.concatenate([voltage[1:], np.full((1, 2), np.nan)]),
            np.concatenate([part.current for part in parts]),
            theta_e=np.concatenate([part.truth for part in parts if part.truth is not None])
            if self.truth is not None and self.truth[0] == "theta_e"
            else None,
        )


def open_log(table: Table, layout: Layout) -> Log:
    """Check that the table has what the layout names, and find the sample time.

    Parameters
    ----------
    table : Table
    layout : Layout

    Raises
    ------
    RecordError
        A column is missing, there is no sample time or two that disagree, there are too few rows,
        or the lag lies outside the record.
    """
    available = table.columns
    names = layout.required(available)
    for option, wanted in (("--column", names), ("--truth", layout.truth)):
        for channel, column in wanted.items():
            if column not in available:
                raise missing_column(table, column, channel, option)
    if table.rows < MINIMUM_ROWS:
        raise RecordError(
            f"{table.path}: {table.rows} rows of data are too few; at least "
            f"{MINIMUM_ROWS} are needed"
        )
    t0, sample_time = 0.0, layout.sample_time
    if "t" in names:
        t0, typical, mean, rows = _measured_time(table, layout, names["t"])
        if sample_time is None:
            sample_time = typical
        # A gap moves the mean, rounding moves the typical step: either may confirm the given one.
        elif min(abs(typical / sample_time - 1), abs(mean / sample_time - 1)) > max(1e-3, 1 / rows):
            raise RecordError(
                f"{table.path}: t advances by {mean:.6g} s a row, but --sample-time is "
                f"{sample_time:.6g} s. Correct one of them (is t in seconds? --scale t=1e-3 for ms)"
            )
    if sample_time is None:
        raise RecordError(
            f"{table.path}: no sample time: there is no column t. Give --sample-time, or "
            f"--column t=COLUMN"
        )
    first, last = 0, table.rows
    start, stop = layout.start, layout.stop
    if start is not None:
        first = max(0, int(np.ceil((start - t0) / sample_time - 1e-6)))
    if stop is not None:
        last = min(table.rows, int(np.floor((stop - t0) / sample_time + 1e-6)) + 1)
    if last - first < MINIMUM_ROWS:
        end = t0 + (table.rows - 1) * sample_time
        raise RecordError(
            f"{table.path}: {max(0, last - first)} rows between --from and --to are too few; the "
            f"log runs from {t0:g} s to {end:g} s"
        )
    check_lag(layout.lag, last - first)
    return Log(table, layout, names, sample_time, t0, first, last)


def _measured_time(table: Table, layout: Layout, column: str) -> tuple[float, float, float, int]:
    """First time, typical step and mean step at the head of the table, and the rows used."""
    t = read_rows(table, [column], 0, min(table.rows, _HEAD))[column]
    t = t * layout.scale.get("t", 1.0) + layout.offset.get("t", 0.0)
    if not np.isfinite(t[[0, -1]]).all() or t[-1] <= t[0] or not np.nanmedian(np.diff(t)) > 0:
        at = int(np.argmax(~np.isfinite(t) | np.r_[False, np.diff(t) <= 0]))
        raise RecordError(
            f"{table.path}, {table.place(at)}: t is missing, stands still or runs backwards. Cut "
            f"the log there, or ignore t with --sample-time and --column t=-"
        )
    step = np.diff(t)
    median = float(np.nanmedian(step))
    ordinary = step[np.abs(step - median) <= 0.6 * abs(median)]
    mean = float(t[-1] - t[0]) / (len(t) - 1)
    return float(t[0]), float(f"{ordinary.mean():.9g}"), mean, len(t)
