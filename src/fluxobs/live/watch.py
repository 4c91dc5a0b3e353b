"""Live estimates from the bytes of a stream."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..errors import RecordError, UsageError
from ..estimation.columns import EstimateRows, rows_of
from ..logs.for_machine import open_for
from ..logs.log import Log
from ..logs.meaning.layout import Layout
from ..logs.scales import Scales, scales_of
from ..logs.time.aligned import Aligned, between, joined, less_lost
from ..machines import Machine, RotatingMachine
from ..observers import LogObserver
from ..observers.for_log import Prepared, prepare
from ..observers.unknowns import ALL, AUTO, read_unknowns
from .even_rows import Spaced
from .frames import HEAD_ROWS, MARK, Frames
from .lines import Lines
from .reorder import Order, Ordered
from .rows import StreamRows

#: Time over which the scales of the signals are measured [s].
WINDOW = 1.0
#: The observer is chosen for scales that are the measured scales times this factor, and chosen
#: again when a signal exceeds its scale by this factor. The settings of the observer need only
#: approximate scales.
GROWN = 2.0
#: Most bytes of a stream that are kept before its first row.
_UNREAD = 1 << 26
#: Bytes that decide whether the stream is text or frames.
_FIRST = 512


@dataclass(frozen=True)
class Status:
    """Counts of a stream so far.

    Attributes
    ----------
    rows : int
        Rows estimated.
    valid : int
        Rows with a valid position.
    lost : int
        Samples missing according to the time stamps.
    damaged : int
        Malformed lines or frames, and rows that were repeated or late.
    restarts : int
        Restarts of the sender.
    chosen : int
        How often the observer was chosen: at first, and whenever the signals have grown.
    waiting : str
        What the observer waits for; "" once the observer runs.
    """

    rows: int
    valid: int
    lost: int
    damaged: int
    restarts: int
    chosen: int
    waiting: str


class Watch:
    """Observer of a stream, run as in firmware: each estimate uses past samples only.

    Parameters
    ----------
    machine : Machine
    head : Path
        File for the first lines of a text stream.
    unknowns : str or sequence of str
        See :func:`fluxobs.estimate`; "auto" means all unknowns of the adaptive observer.
    memory : float, optional
        Memory of the least squares [s].
    priors : mapping, optional
    layout : optional
        Arguments of :func:`fluxobs.read_log`: frame, lag, columns, unit, sample_time, header, ….

    Attributes
    ----------
    log : Log, optional
        Log of the first rows; None until enough rows have arrived.
    """

    def __init__(
        self,
        machine: Machine,
        head: Path,
        unknowns: Any = AUTO,
        memory: float | None = None,
        priors: Mapping[str, float] | None = None,
        **layout: Any,
    ) -> None:
        chosen = read_unknowns(unknowns)
        if chosen == (AUTO,):
            chosen = ALL if isinstance(machine, RotatingMachine) else ("drift",)
        if memory is not None and not 0 < memory < math.inf:
            raise UsageError(f"memory must be a positive number of seconds, got {memory}")
        Layout(**{name: value for name, value in layout.items() if name != "preset"})
        self.machine, self.unknowns = machine, chosen
        self.memory, self.priors = memory, dict(priors or {})
        self.layout, self.head = layout, head
        self.log: Log | None = None
        self.run: Prepared | None = None
        self._incoming: Lines | Frames | None = None
        self._first_bytes = b""
        self._scales: Scales | None = None
        self._recent: list[Aligned] = []
        self._rows_to_measurement = HEAD_ROWS  # rows until the scales are measured
        self._state: Any = None
        self._last_current: Any = None  # of the previous row
        self._rows = self._valid = self._chosen = 0
        self._waiting = ""
        self._record: Callable[[bytes], Any] | None = None
        self._header_recorded = False
        self._unread: list[bytes] = []

    def record(self, to: Callable[[bytes], Any] | None) -> None:
        """Call `to` with the lines of CSV of all further rows, first the names; None stops this."""
        self._record, self._header_recorded = to, False

    @property
    def unread(self) -> bytes:
        """The bytes received before the first row, while recording."""
        return b"".join(self._unread)

    def feed(self, data: bytes, last: bool = False) -> Iterator[EstimateRows]:
        """Add received bytes, with `last` at the end of the stream; yield estimates.

        Rows before the first current flows are not estimated: no observer can be chosen yet.

        Raises
        ------
        FluxobsError
            The stream is malformed, or no observer fits; the message says what to change.
        """
        if self.log is None and self._record is not None and data:
            self._unread.append(data)
            while sum(map(len, self._unread)) > _UNREAD:
                del self._unread[0]
        if self._incoming is None:
            self._first_bytes += data
            if len(self._first_bytes) < _FIRST and not last:
                return
            framed = MARK in self._first_bytes
            header = self.layout.get("header")
            self._incoming = Frames() if framed else Lines(self.head, header)
            data, self._first_bytes = self._first_bytes, b""
        batches = self._incoming.feed(data, last)
        if self.log is None and batches:
            self._open(batches)
            self._unread = []
        if self.log is None:
            return
        for batch in batches:
            yield from self._process_ordered(self._order.add(batch))
        if last:
            yield from self._process_ordered(self._order.end())
            yield from self._estimate_all(self._aligning.end())
            if self.run is None and self._recent:
                yield from self._choose_observer()

    def _process_ordered(self, ordered: Ordered) -> Iterator[EstimateRows]:
        """Record and estimate rows that are in order."""
        assert self._incoming is not None
        assert self.log is not None
        if self._record is not None and ordered.received.rows:
            with_header = not self._header_recorded
            self._record(self._incoming.recorded(ordered, self._order.time, with_header))
            self._header_recorded = True
        columns = self._spaced.add(ordered.received.columns, ordered.t)
        if len(columns["t"]):
            channels, truth = self.log.channels_of(columns)
            yield from self._estimate_all(self._aligning.add(columns["t"], channels, truth))

    @property
    def status(self) -> Status:
        """Counts so far, and what the observer waits for."""
        damaged = 0 if self._incoming is None else self._incoming.damaged
        lost = restarts = 0
        if self.log is not None:
            lost, restarts = self._spaced.lost, self._order.restarts
            damaged += self._order.left_out
        return Status(
            self._rows, self._valid, lost, damaged, restarts, self._chosen, self._reason()
        )

    def _reason(self) -> str:
        """Return what the observer waits for."""
        if self.log is not None:
            return self._waiting
        return (
            f"the stream's first {HEAD_ROWS} rows"
            if self._incoming is None
            else (self._incoming.waiting)
        )

    def _open(self, batches: list[StreamRows]) -> None:
        """Open the first rows as a log, which determines the columns and the sample time."""
        assert self._incoming is not None
        layout = dict(self.layout)
        if isinstance(self._incoming, Frames):
            layout = {**self._incoming.layout, **layout}
            layout.pop("header", None)
        log = self._open_first_rows(batches, layout)
        time = log.names.get("t")
        scale, offset = log.layout.conversion("t")
        # Times are in seconds from here on, and every time column is called "t".
        names = log.names | ({} if time is None else {"t": "t"})
        conversions = {**log.conversions, "t": (1.0, 0.0)}
        clock = log.clock
        if isinstance(self._incoming, Frames):
            clock = replace(clock, wrap=self._incoming.wrap)
        self._order = Order(clock, time, scale, offset)
        self._spaced = Spaced(clock)
        self.log = replace(log, names=names, conversions=conversions)
        self._aligning = self.log.aligning()

    def _open_first_rows(self, batches: list[StreamRows], layout: dict[str, Any]) -> Log:
        """Return the first rows as a log, or a part of them if their times are out of order."""
        assert self._incoming is not None
        problem: RecordError | None = None
        for source in self._incoming.sources(batches):
            try:
                return open_for(source, self.machine, **layout)
            except RecordError as error:
                problem = problem or error
        assert problem is not None
        message = str(problem)
        raise RecordError(message.replace(str(self.head), "the stream")) from None

    def _estimate_all(self, batches: Iterable[Aligned]) -> Iterator[EstimateRows]:
        """Estimate aligned rows. The size of the batches does not change the results."""
        for batch in batches:
            at = 0
            while at < len(batch.t):
                segment = between(batch, at, at + self._rows_to_measurement)
                at += len(segment.t)
                self._rows_to_measurement -= len(segment.t)
                self._recent.append(segment)
                if self.run is not None:
                    yield self._estimate(segment)
                if self._rows_to_measurement == 0:
                    yield from self._choose_observer()

    def _choose_observer(self) -> Iterator[EstimateRows]:
        """Measure the scales; choose the observer at first and whenever the signals have grown."""
        assert self.log is not None
        h, recent = self.log.sample_time, joined(self._recent)
        self._recent, self._rows_to_measurement = [], max(1, round(WINDOW / h))
        try:
            scales = scales_of([recent], h, self.log.path)
        except RecordError as error:  # no current flows yet
            self._waiting = str(error).partition(": ")[2]
            return
        self._waiting = ""
        before = self._scales
        if before is not None and not (
            scales.current > GROWN * before.current or scales.voltage > GROWN * before.voltage
        ):
            return
        roomy = replace(scales, current=GROWN * scales.current, voltage=GROWN * scales.voltage)
        self._scales = roomy
        self.run = prepare(self.log, self.machine, self.unknowns, self.memory, self.priors, roomy)
        self._state = self.run.observer.init()
        self._last_current = None
        self._chosen += 1
        if before is None:
            yield self._estimate(recent)

    def _estimate(self, batch: Aligned) -> EstimateRows:
        assert self.run is not None
        run, before = self.run, self._last_current
        self._last_current = batch.current[-1:]
        if run.log.inverter is not None:
            before = batch.current[:1] if before is None else before
            batch = less_lost(batch, run.log.inverter, before)
        observer: LogObserver[Any, Any] = run.observer
        self._state, estimates = observer.resume(self._state, batch.voltage, batch.current)
        rows = rows_of(run.log, self.machine, run.observer, batch, estimates)
        self._rows += len(rows.valid)
        self._valid += int(rows.valid.sum())
        return rows
