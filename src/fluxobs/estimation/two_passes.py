"""The passes over a log: the first pass learns the parameters, the second pass estimates."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Self

from ..core.output import ahead
from ..logs.log import Log
from ..machines import Machine, RotatingMachine
from ..observers import AdaptiveObserver, LogObserver
from ..observers.adaptive import Learnt
from ..observers.for_log import Prepared, prepare
from ..observers.unknowns import ALL, AUTO
from .columns import EstimateRows, rows_of
from .learning import adaptive_needed, learn, learning_segments
from .statistics import Statistics
from .truth import TruthSamples

#: Called with the number of finished rows and of all rows; both include the first pass.
Progress = Callable[[int, int], Any]


@dataclass
class Passes:
    """An estimation whose first pass is done.

    Attributes
    ----------
    run : Prepared
    unknowns, memory, priors, automatic, causal
        See :class:`fluxobs.estimation.run.LogRun`.
    state : Any
        State from which the observer starts.
    learnt : Learnt, optional
    done : int
        Rows processed in the first pass.
    statistics : Statistics
        Statistics of the rows estimated so far.
    """

    run: Prepared
    unknowns: tuple[str, ...]
    memory: float | None
    priors: Mapping[str, float]
    automatic: bool
    causal: bool
    state: Any = None
    learnt: Learnt | None = None
    done: int = 0
    statistics: Statistics = field(default_factory=lambda: Statistics(0))

    @classmethod
    def begun(
        cls,
        log: Log,
        machine: Machine,
        unknowns: tuple[str, ...],
        memory: float | None,
        priors: Mapping[str, float],
        causal: bool,
        progress: Progress | None = None,
    ) -> Self:
        """Choose the observer, and learn from the whole log if requested.

        Parameters
        ----------
        log : Log
        machine, unknowns, memory, priors, causal, progress
            See :func:`fluxobs.estimate`; `unknowns` come from
            :func:`~fluxobs.observers.unknowns.read_unknowns`.

        Raises
        ------
        FluxobsError
            The unknowns are not identifiable together on this machine, or a setting cannot work.
        """
        automatic = unknowns == (AUTO,)
        if automatic:
            unknowns = ALL if isinstance(machine, RotatingMachine) else ("drift",)
        run = prepare(log, machine, unknowns, memory, priors)
        passes = cls(run, unknowns, memory, priors, automatic, causal)
        if isinstance(run.observer, AdaptiveObserver) and (automatic or not causal):
            passes._learn(run.observer, log, progress)
        total = len(log)
        passes.statistics = Statistics(total)
        if log.true is not None and log.layout.fit_truth and passes.run.plain_outputs:
            passes.statistics.truth = TruthSamples(total, log.true.channel)
        if passes.state is None or causal:
            passes.state = passes.run.observer.init()
        return passes

    def _learn(self, observer: AdaptiveObserver, log: Log, progress: Progress | None) -> None:
        """Run the first pass; discard the learnt parameters if the log does not need them."""
        total = sum(end - start for start, end in learning_segments(self.run.log)) + len(log)

        def count(rows: int) -> None:
            self.done += rows
            if progress is not None:
                progress(self.done, total)

        self.state, self.learnt = learn(self.run, observer, count)
        if self.automatic:
            plain = prepare(log, self.run.machine, ("drift",), self.memory, {})
            if not adaptive_needed(observer, self.learnt, plain):
                self.unknowns, self.priors, self.run = ("drift",), {}, plain
                self.state = self.learnt = None

    def rows(self, progress: Progress | None = None) -> Iterator[EstimateRows]:
        """Yield the estimates, batch by batch."""
        run, observer = self.run, self.run.observer
        log_observer: LogObserver[Any, Any] = observer
        for batch in ahead(run.log.aligned(size=run.batch)):
            self.state, estimates = log_observer.resume(self.state, batch.voltage, batch.current)
            columns = rows_of(run.log, run.machine, observer, batch, estimates)
            self.statistics.add(columns)
            if progress is not None:
                progress(self.done + self.statistics.rows, self.done + self.statistics.total)
            yield columns
        if isinstance(observer, AdaptiveObserver):
            self.learnt = observer.learnt(self.state)

    def found(self) -> dict[str, Any]:
        """Return the fields of a :class:`~fluxobs.estimation.run.LogRun`, after the last row."""
        run = self.run
        log_observer: LogObserver[Any, Any] = run.observer
        return {
            "log": run.log,
            "machine": run.machine,
            "observer": run.observer,
            "scales": run.scales,
            "unknowns": self.unknowns,
            "memory": self.memory,
            "priors": self.priors,
            "statistics": self.statistics,
            "counts": log_observer.counts(self.state),
            "learnt": self.learnt,
            "automatic": self.automatic,
            "causal": self.causal,
        }
