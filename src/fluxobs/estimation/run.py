"""A run and its results: all that its summary, its warnings and its picture need."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ..logs.log import Log
from ..logs.scales import Scales
from ..machines import Machine, RotatingMachine, rotating
from ..observers import AdaptiveObserver, LeastSquaresObserver, SampleCounts
from ..observers.adaptive import Learnt
from ..observers.for_log import AnyObserver
from .statistics import Statistics


@dataclass(frozen=True, eq=False)
class LogRun:
    """A run over a log.

    Attributes
    ----------
    log : Log
        As read; less the inverter's error if the observer does not model it.
    machine : Machine
    observer : LeastSquaresObserver, AdaptiveObserver or ImmersionObserver
        The observer that ran, with all its settings.
    scales : Scales
        Sizes of the log's signals.
    unknowns : tuple of str
    memory : float, optional
        As it was given [s]; the observer's own is ``observer.memory``.
    priors : mapping
    statistics : Statistics
        Counts and means over the rows.
    counts : SampleCounts
        Bad samples and restarts.
    learnt : Learnt, optional
        What the adaptive observer has learnt, if it ran.
    automatic : bool
        Whether the unknowns were chosen by what the log tells.
    causal : bool
        Whether it learnt as it went, not from the whole log.
    """

    log: Log
    machine: Machine
    observer: AnyObserver
    scales: Scales
    unknowns: tuple[str, ...]
    memory: float | None
    priors: Mapping[str, float]
    statistics: Statistics
    counts: SampleCounts
    learnt: Learnt | None
    automatic: bool
    causal: bool

    @property
    def rotor(self) -> RotatingMachine:
        """The machine, if it is a rotating one; it is if a compiled observer ran."""
        return rotating(self.machine, "this part of a result")

    @property
    def plain(self) -> LeastSquaresObserver | None:
        """The plain observer: the one that ran, or the one inside the adaptive observer."""
        if isinstance(self.observer, AdaptiveObserver):
            return self.observer.plain
        return self.observer if isinstance(self.observer, LeastSquaresObserver) else None

    @property
    def adaptive(self) -> AdaptiveObserver | None:
        """The adaptive observer, if it ran."""
        return self.observer if isinstance(self.observer, AdaptiveObserver) else None
