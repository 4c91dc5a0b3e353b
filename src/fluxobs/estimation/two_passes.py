"""The passes over a log: what it tells of the parameters first, then the estimates, row by row."""

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
from .learning import learn, learning_parts, needed
from .statistics import Statistics
from .truth import TruthSamples

#: Called with the number of rows done and the number of all rows, those of the first pass included.
Progress = Callable[[int, int], Any]


@dataclass
class Passes:
    """An estimation of which the first pass is done.

    Attributes
    ----------
    run : Prepared
    unknowns, memory, priors, automatic, causal
        See :class:`fluxobs.estimation.run.LogRun`.
    state : Any
        In which the observer starts.
    learnt : Learnt, optional
    done : int
        Rows of the first pass.
    statistics : Statistics
        Of the rows so far.
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
        """Choose the observer, and learn from the whole log if that is wanted.

        Parameters
        ----------
        log : Log
        machine, unknowns, memory, priors, causal, progress
            See :func:`fluxobs.estimate`; the unknowns as
            :func:`~fluxobs.observers.unknowns.read_unknowns` returns them.

        Raises
        ------
        FluxobsError
            The unknowns cannot be told apart on this machine, or a setting cannot work.
        """
        automatic = unknowns == (AUTO,)
        if automatic:
            unknowns = ALL if isinstance(machine, RotatingMachine) else ("drift",)
        run = prepare(log, machine, unknowns, memory, priors)
        made = cls(run, unknowns, memory, priors, automatic, causal)
        if isinstance(run.observer, AdaptiveObserver) and (automatic or not causal):
            made._learn(run.observer, log, progress)
        total = len(log)
        made.statistics = Statistics(total)
        if log.true is not None and log.layout.fit_truth and made.run.plain_outputs:
            made.statistics.truth = TruthSamples(total, log.true.channel)
        if made.state is None or causal:
            made.state = made.run.observer.init()
        return made

    def _learn(self, observer: AdaptiveObserver, log: Log, progress: Progress | None) -> None:
        """The first pass; what it learns is forgotten if the log does not ask for it."""
        of = sum(last - first for first, last in learning_parts(self.run.log)) + len(log)

        def tell(rows: int) -> None:
            self.done += rows
            if progress is not None:
                progress(self.done, of)

        self.state, self.learnt = learn(self.run, observer, tell)
        if self.automatic:
            plain = prepare(log, self.run.machine, ("drift",), self.memory, {})
            if not needed(observer, self.learnt, plain):
                self.unknowns, self.priors, self.run = ("drift",), {}, plain
                self.state = self.learnt = None

    def rows(self, progress: Progress | None = None) -> Iterator[EstimateRows]:
        """Make the estimates, batch by batch."""
        run, observer = self.run, self.run.observer
        steps: LogObserver[Any, Any] = observer
        for part in ahead(run.log.aligned(size=run.batch)):
            self.state, found = steps.resume(self.state, part.voltage, part.current)
            rows = rows_of(run.log, run.machine, observer, part, found)
            self.statistics.add(rows)
            if progress is not None:
                progress(self.done + self.statistics.rows, self.done + self.statistics.total)
            yield rows
        if isinstance(observer, AdaptiveObserver):
            self.learnt = observer.learnt(self.state)

    def found(self) -> dict[str, Any]:
        """The fields of a :class:`~fluxobs.estimation.run.LogRun`, when all rows are made."""
        run = self.run
        counts: LogObserver[Any, Any] = run.observer
        return {
            "log": run.log,
            "machine": run.machine,
            "observer": run.observer,
            "scales": run.scales,
            "unknowns": self.unknowns,
            "memory": self.memory,
            "priors": self.priors,
            "statistics": self.statistics,
            "counts": counts.counts(self.state),
            "learnt": self.learnt,
            "automatic": self.automatic,
            "causal": self.causal,
        }
