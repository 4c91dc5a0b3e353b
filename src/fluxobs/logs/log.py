"""Log: a table and the meaning of its columns; it yields aligned currents and voltages."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..core.arrays import Array
from ..errors import RecordError
from ..machines.model.frames import Frame
from ..machines.model.held import Held
from ..machines.model.inverter import InverterError
from .formats import BATCH, Table
from .formats.table import Columns
from .meaning.layout import Layout
from .record import Record, check_lag
from .time.aligned import Aligned, Aligning
from .time.clock import Clock

MINIMUM_ROWS = 20


@dataclass(frozen=True, eq=False)
class Truth:
    """Truth channel of a log, and the columns that contain the channel.

    Attributes
    ----------
    channel : str
    columns : tuple of str
    guessed : bool
        Whether the channel was guessed, not named by the user.
    centre, size : (n,) ndarray
        Offsets and amplitudes that scale sine and cosine to a unit circle; for three Hall signals,
        `centre` holds the thresholds.
    """

    channel: str
    columns: tuple[str, ...]
    guessed: bool = False
    centre: Array = field(default_factory=lambda: np.zeros(2))
    size: Array = field(default_factory=lambda: np.ones(2))

    @property
    def angular(self) -> bool:
        """Whether the channel is an angle of the rotor."""
        return self.channel.startswith("theta")

    def of(self, values: list[Array]) -> Array:
        """Return the channel in the unit of its columns; NaN where a value is missing."""
        values = [np.where(np.isfinite(value), value, np.nan) for value in values]
        if self.channel == "hall" and len(values) == 1:
            integral = values[0] == np.round(values[0])
            return np.asarray(np.where(integral, values[0], np.nan))
        if self.channel == "hall" and len(values) == 3:
            levels = [value > centre for value, centre in zip(values, self.centre, strict=True)]
            code = sum(bit.astype(float) * 2**n for n, bit in enumerate(levels))
            finite = np.isfinite(np.stack(values)).all(axis=0)
            return np.asarray(np.where(finite, code, np.nan))
        if len(values) == 2:
            sin, cos = (
                (value - centre) / size
                for value, centre, size in zip(values, self.centre, self.size, strict=True)
            )
            return np.asarray(np.arctan2(sin, cos))
        return values[0]


@dataclass(frozen=True, eq=False)
class Log:
    """Table on uniform rows with its layout; rows first … last - 1 are read.

    Returned by :func:`fluxobs.read_log`.

    Attributes
    ----------
    table : Table
    layout : Layout
    names : dict
        Channel → column.
    conversions : dict
        Channel → (scale, offset) that convert the channel's column to SI.
    clock : Clock
    first, last : int
    notes : tuple of str
        Guesses, and defects of the file that were repaired.
    true : Truth, optional
    inverter : InverterError, optional
        Error that is subtracted from the commanded voltage.
    """

    table: Table
    layout: Layout
    names: dict[str, str]
    conversions: Mapping[str, tuple[float, float]]
    clock: Clock
    first: int
    last: int
    notes: tuple[str, ...] = ()
    true: Truth | None = None
    inverter: InverterError | None = None

    def __len__(self) -> int:
        return self.last - self.first

    def __repr__(self) -> str:
        return f"<Log: {self.path.name}, {len(self)} rows, {self.sample_time:g} s apart>"

    @property
    def path(self) -> Path:
        """Path of the file; for arrays, a placeholder name."""
        return self.table.path

    @property
    def frame(self) -> Frame:
        """Frame of the vectors."""
        return self.layout.frame or "alphabeta"

    @property
    def current_frame(self) -> Frame:
        """Frame of the currents, which may differ from that of the voltages."""
        return self.layout.currents or self.frame

    @property
    def sample_time(self) -> float:
        """Time between rows [s]."""
        return self.clock.sample_time

    @property
    def truth(self) -> tuple[str, str] | None:
        """Channel and column of the truth, or None without a truth."""
        return None if self.true is None else (self.true.channel, ",".join(self.true.columns))

    @property
    def held(self) -> Held:
        """Whether the voltages are held over a sample (:mod:`fluxobs.machines.model.held`)."""
        if self.layout.held is not None:
            return self.layout.held
        return "auto" if self.layout.lag == round(self.layout.lag) else False

    def less_inverter(self, inverter: InverterError | None) -> Log:
        """Return the log with the inverter's error subtracted from its commanded voltages."""
        return replace(self, inverter=inverter)

    def lagged(self, by: float) -> Log:
        """Return the log with voltages that act `by` samples earlier."""
        return replace(self, layout=self.layout.model_copy(update={"lag": self.layout.lag + by}))

    @property
    def columns(self) -> list[str]:
        """Names of the columns that are read."""
        return [*self.names.values(), *(() if self.true is None else self.true.columns)]

    def _scaled(self, channel: str, values: Array) -> Array:
        scale, offset = self.conversions.get(channel, (1.0, 0.0))
        values = values if scale == 1.0 else values * scale
        return values if offset == 0.0 else values + offset

    def channels_of(self, batch: Columns) -> tuple[Columns, Array | None]:
        """Return scaled channels and truth of a batch of the table, before any transform."""
        channels = {name: self._scaled(name, batch[column]) for name, column in self.names.items()}
        if self.frame == "duty" and self.layout.udc is not None:
            link = np.full(len(next(iter(channels.values()))), self.layout.udc)
            channels["udc"] = self._scaled("udc", link)
        if self.true is None:
            return channels, None
        values = self.true.of([batch[column] for column in self.true.columns])
        return channels, self._scaled(self.true.channel, values)

    def channels(self, first: int, last: int) -> Iterator[Columns]:
        """Yield scaled channels in batches, before any transform; "truth" is the truth channel."""
        for batch in self.table.batches(self.columns, first, last, BATCH):
            channels, truth = self.channels_of(batch)
            yield channels if truth is None else channels | {"truth": truth}

    def _time(self, channels: Columns, row: int, count: int) -> Array:
        if "t" in channels:
            return channels["t"]
        return self.clock.times(np.arange(row, row + count))

    def aligned(
        self, first: int | None = None, last: int | None = None, size: int = BATCH
    ) -> Iterator[Aligned]:
        """Yield rows in order, with inverter losses subtracted; the batch size has no effect.

        Raises
        ------
        RecordError
            A value is not a number; the message names the place.
        """
        first = self.first if first is None else first
        last = self.last if last is None else last
        aligning = self.aligning(first)
        row = first
        for batch in self.table.batches(self.columns, first, last, size):
            channels, truth = self.channels_of(batch)
            t = self._time(channels, row, len(next(iter(channels.values()))))
            yield from aligning.add(t, channels, truth)
            row += len(t)
        yield from aligning.end()

    def aligning(self, first: int = 0) -> Aligning:
        """Return the :class:`Aligning` of the log's rows from row `first` on."""
        return Aligning(self.frame, self.current_frame, self.layout.lag, self.inverter, first)

    def to_record(self) -> Record:
        """Load the whole log into memory; its voltages are aligned, so its lag is 0."""
        batches = list(self.aligned())
        voltage = np.concatenate([batch.voltage for batch in batches])
        return Record(
            self.sample_time,
            # Row k of a record acts from t_k on: the interval ending at t_k belongs to row k - 1.
            np.concatenate([voltage[1:], np.full((1, 2), np.nan)]),
            np.concatenate([batch.current for batch in batches]),
            lag=0.0 if self.layout.lag_stated else None,
            theta_e=np.concatenate([batch.truth for batch in batches if batch.truth is not None])
            if self.true is not None and self.true.channel == "theta_e"
            else None,
        )


def rows_between(layout: Layout, clock: Clock, path: Path) -> tuple[int, int]:
    """Return the first row within the times of a layout, and the row after the last one.

    Raises
    ------
    RecordError
        The rows are too few, or the lag exceeds the number of rows.
    """
    first, last = 0, clock.rows
    if clock.rows < MINIMUM_ROWS:
        raise RecordError(
            f"{path}: {clock.rows} rows of data are too few; at least {MINIMUM_ROWS} are needed"
        )
    if layout.start is not None:
        first = clock.row_at(layout.start, up=True)
    if layout.stop is not None:
        last = clock.row_at(layout.stop, up=False)
    if last - first < MINIMUM_ROWS:
        raise RecordError(
            f"{path}: {max(0, last - first)} rows between --from and --to are too few; the log "
            f"runs from {clock.t0:g} s to {clock.end:g} s"
        )
    check_lag(layout.lag, last - first)
    return first, last
