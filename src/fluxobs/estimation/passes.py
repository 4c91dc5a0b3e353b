"""The passes over a log: the observer learns forwards, then every row is estimated."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Self

from ..core.output import ahead
from ..core.validation import nearest, number
from ..errors import FluxobsError
from ..logs.log import Log
from ..machines import Machine, RotatingMachine
from ..observers import AdaptiveObserver, LogObserver
from ..observers.adaptive import Learnt
from ..observers.for_log import Prepared, prepare
from ..observers.unknowns import ALL, AUTO, PRIORS
from ..smoothing.assumptions import GIVEN, check_given
from .columns import EstimateRows, rows_of
from .lag import LAGS
from .learning import learn
from .statistics import Statistics
from .truth import TruthSamples
from .whole_log import WholeLog

#: Called with the number of finished rows and of all rows; both include the first pass.
Progress = Callable[[int, int], Any]


def check_priors(priors: Mapping[str, float], causal: bool) -> None:
    """Raise FluxobsError if a standard deviation has an unknown name or no possible value."""
    for name, std in priors.items():
        if causal and name in GIVEN:
            raise FluxobsError(
                f"prior {name}: the observer of a drive does not use it; omit the prior, or "
                f"--causal"
            )
        if name not in (*PRIORS, *GIVEN):
            raise FluxobsError(f"prior: unknown {name!r}{nearest(name, (*PRIORS, *GIVEN))}")
        if not 0 <= number(f"prior {name}", std, "SI") < float("inf"):
            raise FluxobsError(f"prior {name}={std:g}: must be finite and not negative")
    if "asymmetry" in priors and "voltage_gain" in priors:
        raise FluxobsError(
            "priors asymmetry and voltage_gain are the same quantity: give only one of them"
        )


def adaptive_priors(priors: Mapping[str, float]) -> dict[str, float]:
    """Return the standard deviations that the observer uses."""
    return {name: std for name, std in priors.items() if name in PRIORS}


@dataclass
class Passes:
    """An estimation whose observer has learnt.

    Attributes
    ----------
    run : Prepared
    unknowns, memory, priors, automatic, causal
        See :class:`fluxobs.estimation.run.LogRun`.
    shifts : tuple of int
        Possible errors of the log's lag [samples].
    state : Any
        State from which the observer starts.
    learnt : Learnt, optional
    whole : WholeLog, optional
        The smoother; None if rows are estimated from the rows before them alone.
    done : int
        Rows processed before the first row is estimated.
    statistics : Statistics
        Statistics of the rows estimated so far.
    """

    run: Prepared
    unknowns: tuple[str, ...]
    memory: float | None
    priors: Mapping[str, float]
    automatic: bool
    causal: bool
    shifts: tuple[int, ...] = (0,)
    state: Any = None
    learnt: Learnt | None = None
    whole: WholeLog | None = None
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
        """Choose the observer, and learn from the whole log unless the run is causal.

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
        check_priors(priors, causal)
        if isinstance(machine, RotatingMachine):
            check_given(machine, priors)
        priors = dict(log.layout.priors) | dict(priors)
        check_priors(priors, False)
        automatic = unknowns == (AUTO,)
        if automatic:
            unknowns = ALL if isinstance(machine, RotatingMachine) else ("drift",)
        run = prepare(log, machine, unknowns, memory, adaptive_priors(priors))
        shifts = (0,) if log.layout.lag_stated else LAGS
        passes = cls(run, unknowns, memory, priors, automatic, causal, shifts)
        passes.start(progress)
        return passes

    def start(self, progress: Progress | None = None) -> None:
        """Learn from the whole log unless the run is causal."""
        run, log = self.run, self.run.log
        self.state = run.observer.init()
        rotating = isinstance(run.machine, RotatingMachine)
        smoothed = not self.causal and rotating and run.plain_outputs
        total = len(log)
        self.statistics = Statistics(total)
        if log.true is not None and log.layout.fit_truth and run.plain_outputs:
            self.statistics.truth = TruthSamples(total, log.true.channel)

        def count(rows: int) -> None:
            self.done += rows
            if progress is not None:
                progress(self.done, self.done + total)

        if smoothed:
            if isinstance(run.observer, AdaptiveObserver):
                self.state, self.learnt = learn(run, run.observer, count)
            self.whole = WholeLog(run, self.state, self.learnt, self.priors, count, self.shifts)

    def rows(self, progress: Progress | None = None) -> Iterator[EstimateRows]:
        """Yield the estimates, batch by batch."""
        for columns in self._forwards() if self.whole is None else self.whole.rows():
            self.statistics.add(columns)
            if progress is not None:
                progress(self.done + self.statistics.rows, self.done + self.statistics.total)
            yield columns
        observer = self.run.observer
        if self.whole is not None:
            self.state = self.whole.state
            self.learnt = self.whole.parameters(self.statistics)
        elif isinstance(observer, AdaptiveObserver):
            self.learnt = observer.learnt(self.state)

    def _forwards(self) -> Iterator[EstimateRows]:
        """Yield the estimates of the observer, as in a drive."""
        run, observer = self.run, self.run.observer
        log_observer: LogObserver[Any, Any] = observer
        for batch in ahead(run.aligned()):
            self.state, estimates = log_observer.resume(self.state, batch.voltage, batch.current)
            yield rows_of(run.log, run.machine, observer, batch, estimates)

    def found(self) -> dict[str, Any]:
        """Return the fields of a :class:`~fluxobs.estimation.run.LogRun`, after the last row."""
        run = self.run
        log_observer: LogObserver[Any, Any] = run.observer
        lag = None if self.whole is None else self.whole.lag()
        return {
            "log": run.log if lag is None else run.log.lagged(lag.lag - run.log.layout.lag),
            "lag": lag,
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
            "budget": None if self.whole is None else self.whole.budget,
            "fractional_lag": None if self.whole is None else self.whole.fractional_lag(),
            "examined": None if self.whole is None else self.whole.checked,
        }
