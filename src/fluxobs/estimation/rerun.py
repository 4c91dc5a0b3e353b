"""Repeated runs over a log in memory, with other parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from ..logs.log import Log
from ..logs.scales import Scales
from ..logs.time.aligned import Aligned, joined, less_lost
from ..machines import Machine
from ..observers.for_log import prepare
from .columns import EstimateRows, joined_rows
from .passes import Passes, adaptive_priors


class Again:
    """A log in memory, for repeated runs.

    Each run gives the numbers of :func:`fluxobs.estimate` with the same settings, but uses the
    sizes of the signals given here. The log is not read or checked again.

    Parameters
    ----------
    log : Log
    scales : Scales
        Sizes of the log's signals.
    """

    def __init__(self, log: Log, scales: Scales) -> None:
        self.log, self.scales = log.less_inverter(None), scales
        self._samples: dict[float, Aligned] = {}

    def rows(
        self,
        machine: Machine,
        unknowns: tuple[str, ...],
        memory: float | None = None,
        priors: Mapping[str, float] | None = None,
        lag: float | None = None,
    ) -> EstimateRows:
        """Return the estimates of all rows.

        Parameters
        ----------
        machine, memory, priors
            See :func:`fluxobs.estimate`.
        unknowns : tuple of str
            Not "auto".
        lag : float, optional
            Lag in samples; default: the lag of the log.
        """
        shift = 0.0 if lag is None else lag - self.log.layout.lag
        log = self.log.lagged(shift)
        run = prepare(log, machine, unknowns, memory, adaptive_priors(priors or {}), self.scales)
        samples = self._aligned(log)
        if run.log.inverter is not None:
            samples = less_lost(samples, run.log.inverter, samples.current[:1])
        run = replace(run, samples=samples)
        passes = Passes(run, unknowns, memory, priors or {}, automatic=False, causal=False)
        passes.start()
        return joined_rows(list(passes.rows()))

    def _aligned(self, log: Log) -> Aligned:
        """Return all rows with the commanded voltages; cache the rows of the last two lags."""
        lag = log.layout.lag
        if lag not in self._samples:
            if len(self._samples) > 1:
                self._samples.pop(next(iter(self._samples)))
            self._samples[lag] = joined(list(log.aligned()))
        return self._samples[lag]
