"""Another run over a log that is in memory: other parameters, the same rows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..logs.aligned import Aligned, joined, less_lost
from ..logs.log import Log
from ..logs.scales import Scales
from ..machines import Machine
from ..observers import AdaptiveObserver
from ..observers.for_log import prepare
from .columns import EstimateRows, rows_of


class Again:
    """A log kept in memory, for run after run.

    Each gives the numbers of :func:`fluxobs.estimate` with the same settings, but for the sizes of
    the signals, which are measured only once; the log is neither read nor checked again.

    Parameters
    ----------
    log : Log
    scales : Scales
        Sizes of its signals.
    """

    def __init__(self, log: Log, scales: Scales) -> None:
        self.log, self.scales = log.less_inverter(None), scales
        self._parts: dict[float, Aligned] = {}

    def rows(
        self,
        machine: Machine,
        unknowns: tuple[str, ...],
        memory: float | None = None,
        priors: Mapping[str, float] | None = None,
        lag: float | None = None,
    ) -> EstimateRows:
        """The estimates of all rows.

        Parameters
        ----------
        machine, memory, priors
            See :func:`fluxobs.estimate`.
        unknowns : tuple of str
            Not "auto".
        lag : float, optional
            In samples; default: the log's.
        """
        by = 0.0 if lag is None else lag - self.log.layout.lag
        log = self.log.lagged(by)
        run = prepare(log, machine, unknowns, memory, priors or {}, self.scales)
        part = self._aligned(log)
        if run.log.inverter is not None:
            part = less_lost(part, run.log.inverter, part.current[:1])
        observer: Any = run.observer
        state = observer.init()
        if isinstance(observer, AdaptiveObserver):
            state = observer.resume(state, part.voltage, part.current)[0]
            state = observer.restart(state, frozen=True)
        found = observer.resume(state, part.voltage, part.current)[1]
        return rows_of(run.log, machine, observer, part, found)

    def _aligned(self, log: Log) -> Aligned:
        """All rows with the voltages as commanded; those of the last two lags are kept."""
        lag = log.layout.lag
        if lag not in self._parts:
            if len(self._parts) > 1:
                self._parts.pop(next(iter(self._parts)))
            self._parts[lag] = joined(list(log.aligned()))
        return self._parts[lag]
