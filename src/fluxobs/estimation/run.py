"""A run and its results: the data of its summary, warnings and picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ..checking.findings import Check
from ..logs.log import Log
from ..logs.scales import Scales
from ..machines import Machine, RotatingMachine, rotating
from ..observers import AdaptiveObserver, LeastSquaresObserver, SampleCounts
from ..observers.adaptive import Learnt
from ..observers.for_log import AnyObserver
from .budget import Budget
from .lag import LagDecision
from .statistics import Statistics


@dataclass(frozen=True, eq=False)
class LogRun:
    """A run over a log.

    Attributes
    ----------
    log : Log
        The log as read, without the inverter's error if the observer does not model this error.
    machine : Machine
    observer : LeastSquaresObserver, AdaptiveObserver or ImmersionObserver
        The observer that ran, with all its settings.
    scales : Scales
        Sizes of the log's signals.
    unknowns : tuple of str
    memory : float, optional
        The given memory [s]; the memory in use is ``observer.memory``.
    priors : mapping
    statistics : Statistics
        Counts and means over the rows.
    counts : SampleCounts
        Bad samples and restarts.
    learnt : Learnt, optional
        Parameters that the adaptive observer learnt; None if another observer ran.
    automatic : bool
        Whether the unknowns were chosen from the log.
    causal : bool
        Whether rows were estimated from the rows before them alone, as in a drive.
    budget : Budget, optional
        Error budget of the position; None if the run was causal or an immersed observer ran.
    lag : LagDecision, optional
        Lag that was learnt from the log; None if it was stated or not learnt.
    fractional_lag : (float, float), optional
        Lag of the voltages behind the currents and its standard deviation [samples], if the whole
        log was smoothed.
    examined : Check, optional
        Check of the log; None if it was not checked yet, or cannot be checked.
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
    budget: Budget | None
    lag: LagDecision | None
    fractional_lag: tuple[float, float] | None
    examined: Check | None

    @property
    def rotor(self) -> RotatingMachine:
        """The machine, which rotates in every run of a compiled observer."""
        return rotating(self.machine, "this part of a result")

    @property
    def plain(self) -> LeastSquaresObserver | None:
        """The plain observer that ran, alone or inside the adaptive observer."""
        if isinstance(self.observer, AdaptiveObserver):
            return self.observer.plain
        return self.observer if isinstance(self.observer, LeastSquaresObserver) else None

    @property
    def adaptive(self) -> AdaptiveObserver | None:
        """The adaptive observer; None if another observer ran."""
        return self.observer if isinstance(self.observer, AdaptiveObserver) else None
