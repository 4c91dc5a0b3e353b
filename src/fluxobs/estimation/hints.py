"""Hints for the posterior of a log: the angles of the observer, which runs over the log twice."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array, runs
from ..core.output import ahead
from ..logs.time.aligned import Aligned, joined
from ..observers import AdaptiveObserver
from ..observers.adaptive import Learnt
from ..observers.for_log import Prepared
from .anchors import anchored, anchors_of

#: Rows that the engine needs to begin with (engine/growth.c), and the deviation of an angle that is
#: a hint if so many rows are not valid [rad].
FIRST_ROWS, POOR_STD = 40, 0.3


@dataclass(frozen=True, eq=False)
class Forwards:
    """A pass of the observer over a log.

    Attributes
    ----------
    samples : Aligned
    estimate : Estimate
        Of the observer, of all rows.
    state : Any
        Of the observer, after the last row.
    """

    samples: Aligned
    estimate: Any
    state: Any

    @property
    def known(self) -> NDArray[np.bool_]:
        """Whether a row is valid, with an angle."""
        return np.asarray(self.estimate.valid & np.isfinite(self.estimate.theta_e))


def forwards(run: Prepared, state: Any) -> Forwards:
    """Run the observer over all rows of a log."""
    observer: Any = run.observer
    batches, parts = [], []
    for batch in ahead(run.aligned()):
        state, estimates = observer.resume(state, batch.voltage, batch.current)
        batches.append(batch)
        parts.append(estimates)
    return Forwards(joined(batches), joined_estimates(parts), state)


def joined_estimates(parts: list[Any]) -> Any:
    """Join estimates of consecutive rows."""
    first = parts[0]
    if len(parts) == 1:
        return first
    names = first.__dataclass_fields__
    return replace(
        first, **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    )


@dataclass(frozen=True, eq=False)
class Hints:
    """Angles of an observer, where it knows them.

    Attributes
    ----------
    angle : (rows,) ndarray
        [rad]; NaN: unknown.
    sure : bool
        Whether the first pass, which is that of a drive, calls long runs of rows valid.
    first : Forwards
        The first pass.
    learnt : Learnt, optional
        Parameters that the adaptive observer learnt in it.
    """

    angle: Array
    sure: bool
    first: Forwards
    learnt: Learnt | None


def hints_of(run: Prepared) -> Hints:
    """Run the observer twice: as in a drive, and with the parameters that it has learnt.

    Where neither is valid for long enough, less certain angles count, which are not sure.
    """
    observer: Any = run.observer
    first = forwards(run, observer.init())
    second, learnt = first, None
    if isinstance(observer, AdaptiveObserver):
        learnt = observer.learnt(first.state)
        second = forwards(run, observer.restart(first.state, frozen=True))
    valid, known = first.known, anchors_of(anchored(second.samples, second.estimate))
    sure = _longest(valid) >= FIRST_ROWS
    if not sure and _longest(known) < FIRST_ROWS:
        known = known | (second.estimate.theta_e_std < POOR_STD)
    other = np.where(known, second.estimate.theta_e, np.nan)
    return Hints(np.where(valid, first.estimate.theta_e, other), sure, first, learnt)


def _longest(known: NDArray[np.bool_]) -> int:
    return max((int(end - start) for start, end in runs(known)), default=0)
