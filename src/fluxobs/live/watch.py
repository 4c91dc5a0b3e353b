"""The estimates of a stream, as its bytes come."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..errors import RecordError, UsageError
from ..estimation.columns import EstimateRows, rows_of
from ..logs.aligned import Aligned, between, joined, less_lost
from ..logs.for_machine import open_for
from ..logs.layout import Layout
from ..logs.log import Log
from ..logs.scales import Scales, scales_of
from ..machines import Machine, RotatingMachine
from ..observers import LogObserver
from ..observers.for_log import Prepared, prepare
from ..observers.unknowns import ALL, AUTO, read_unknowns
from .even_rows import Spaced
from .frames import HEAD_ROWS, MARK, Frames
from .lines import Lines
from .reorder import Order, Ordered
from .rows import StreamRows

#: The scales of the signals are measured over this time [s].
WINDOW = 1.0
#: The observer is chosen for signals larger than the first ones by this factor, and again when a
#: signal exceeds that scale by it. Its settings need a scale right within a factor of a few.
GROWN = 2.0
#: Bytes kept of a stream until its first row.
_UNREAD = 1 << 26
#: The first bytes of a stream decide whether it is text or frames.
_FIRST = 512


@dataclass(frozen=True)
class Status:
    """What has come.

    Attributes
    ----------
    rows : int
        Rows that were estimated.
    valid : int
        Those whose position is known.
    lost : int
        Samples that are missing, by their stamps.
    damaged : int
        Lines or frames that were no rows, and rows that came twice or late.
    restarts : int
        How often the sender began anew.
    chosen : int
        How often the observer was chosen: anew whenever the signals have grown.
    waiting : str
        What the observer waits for; "" once it runs.
    """

    rows: int
    valid: int
    lost: int
    damaged: int
    restarts: int
    chosen: int
    waiting: str


class Watch:
    """Runs the observer over a stream, as firmware would: it learns as it goes.

    Parameters
    ----------
    machine : Machine
    head : Path
        A file in which the first lines of a stream of text are kept.
    unknowns : str or sequence of str
        As for :func:`fluxobs.estimate`; "auto" is all that the adaptive observer finds.
    memory : float, optional
        [s].
    priors : mapping, optional
    layout : optional
        As for :func:`fluxobs.read_log`: frame, lag, columns, unit, sample_time, header, and more.

    Attributes
    ----------
    log : Log, optional
        The first rows, opened; None until there are enough.
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
        self._first = b""
        self._scales: Scales | None = None
        self._recent: list[Aligned] = []
        self._left = HEAD_ROWS  # rows until the sizes of the signals are measured
        self._state: Any = None
        self._before: Any = None
        self._rows = self._valid = self._chosen = 0
        self._waiting = ""
        self._record: Callable[[bytes], Any] | None = None
        self._headed = False
        self._unread: list[bytes] = []

    def record(self, to: Callable[[bytes], Any] | None) -> None:
        """Call `to` with the lines of a CSV file of the rows from now on, names first; or stop."""
        self._record, self._headed = to, False

    @property
    def unread(self) -> bytes:
        """While it is recorded: what came before there were rows, as it came."""
        return b"".join(self._unread)

    def feed(self, data: bytes, last: bool = False) -> Iterator[EstimateRows]:
        """Take bytes as they come, the last ones with `last`; yield estimates.

        Rows before the observer is chosen, for want of a current, are not estimated.

        Raises
        ------
        FluxobsError
            The stream cannot be read, or no observer fits; the message says what to change.
        """
        if self.log is None and self._record is not None and data:
            self._unread.append(data)
            while sum(map(len, self._unread)) > _UNREAD:
                del self._unread[0]
        if self._incoming is None:
            self._first += data
            if len(self._first) < _FIRST and not last:
                return
            framed = MARK in self._first
            header = self.layout.get("header")
            self._incoming = Frames() if framed else Lines(self.head, header)
            data, self._first = self._first, b""
        parts = self._incoming.feed(data, last)
        if self.log is None and parts:
            self._open(parts)
            self._unread = []
        if self.log is None:
            return
        for part in parts:
            yield from self._ordered(self._order.add(part))
        if last:
            yield from self._ordered(self._order.end())
            yield from self._estimates(self._aligning.end())
            if self.run is None and self._recent:
                yield from self._measured()

    def _ordered(self, rows: Ordered) -> Iterator[EstimateRows]:
        """Record and estimate rows that are in order."""
        assert self._incoming is not None
        assert self.log is not None
        if self._record is not None and rows.part.rows:
            self._record(self._incoming.recorded(rows, self._order.time, not self._headed))
            self._headed = True
        columns = self._spaced.add(rows.part.columns, rows.t)
        if len(columns["t"]):
            channels, truth = self.log.channels_of(columns)
            yield from self._estimates(self._aligning.add(columns["t"], channels, truth))

    @property
    def status(self) -> Status:
        """What has come so far."""
        damaged = 0 if self._incoming is None else self._incoming.damaged
        lost = restarts = 0
        if self.log is not None:
            lost, restarts = self._spaced.lost, self._order.restarts
            damaged += self._order.left_out
        return Status(self._rows, self._valid, lost, damaged, restarts, self._chosen, self._wait())

    def _wait(self) -> str:
        """What the observer waits for."""
        if self.log is not None:
            return self._waiting
        return (
            f"the stream's first {HEAD_ROWS} rows"
            if self._incoming is None
            else (self._incoming.waiting)
        )

    def _open(self, parts: list[StreamRows]) -> None:
        """Open the first rows as a log: what its columns are, and how far apart its rows."""
        assert self._incoming is not None
        given = dict(self.layout)
        if isinstance(self._incoming, Frames):
            given = {**self._incoming.layout, **given}
            given.pop("header", None)
        log = self._opened(parts, given)
        time = log.names.get("t")
        scale, offset = log.layout.conversion("t")
        # From here on its times are seconds already, and the time column has any name.
        names = log.names | ({} if time is None else {"t": "t"})
        conversions = {**log.conversions, "t": (1.0, 0.0)}
        clock = log.clock
        if isinstance(self._incoming, Frames):
            clock = replace(clock, wrap=self._incoming.wrap)
        self._order = Order(clock, time, scale, offset)
        self._spaced = Spaced(clock)
        self.log = replace(log, names=names, conversions=conversions)
        self._aligning = self.log.aligning()

    def _opened(self, parts: list[StreamRows], given: dict[str, Any]) -> Log:
        """The first rows as a log; where time is not in order among them, a piece of them."""
        assert self._incoming is not None
        problem: RecordError | None = None
        for source in self._incoming.sources(parts):
            try:
                return open_for(source, self.machine, **given)
            except RecordError as error:
                problem = problem or error
        assert problem is not None
        words = str(problem)
        raise RecordError(words.replace(str(self.head), "the stream")) from None

    def _estimates(self, parts: Iterable[Aligned]) -> Iterator[EstimateRows]:
        """Estimate aligned rows. How many come at once changes no number."""
        for part in parts:
            at = 0
            while at < len(part.t):
                piece = between(part, at, at + self._left)
                at += len(piece.t)
                self._left -= len(piece.t)
                self._recent.append(piece)
                if self.run is not None:
                    yield self._estimated(piece)
                if self._left == 0:
                    yield from self._measured()

    def _measured(self) -> Iterator[EstimateRows]:
        """Choose the observer, at first and whenever the signals have grown."""
        assert self.log is not None
        h, recent = self.log.sample_time, joined(self._recent)
        self._recent, self._left = [], max(1, round(WINDOW / h))
        try:
            found = scales_of([recent], h, self.log.path)
        except RecordError as error:  # nothing flows yet
            self._waiting = str(error).partition(": ")[2]
            return
        self._waiting = ""
        known = self._scales
        if known is not None and not (
            found.current > GROWN * known.current or found.voltage > GROWN * known.voltage
        ):
            return
        roomy = replace(found, current=GROWN * found.current, voltage=GROWN * found.voltage)
        self._scales = roomy
        self.run = prepare(self.log, self.machine, self.unknowns, self.memory, self.priors, roomy)
        self._state = self.run.observer.init()
        self._before = None
        self._chosen += 1
        if known is None:
            yield self._estimated(recent)

    def _estimated(self, part: Aligned) -> EstimateRows:
        assert self.run is not None
        run, before = self.run, self._before
        self._before = part.current[-1:]
        if run.log.inverter is not None:
            part = less_lost(part, run.log.inverter, part.current[:1] if before is None else before)
        observer: LogObserver[Any, Any] = run.observer
        self._state, found = observer.resume(self._state, part.voltage, part.current)
        rows = rows_of(run.log, self.machine, run.observer, part, found)
        self._rows += len(rows.valid)
        self._valid += int(rows.valid.sum())
        return rows
