"""The first pass over a recorded log: what it tells about the parameters, and what is taken."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..observers import AdaptiveObserver
from ..observers.adaptive import Learnt
from ..observers.compiled import CompiledState
from ..output import ahead
from .prepare import Prepared

#: Nothing was learnt about a parameter whose standard deviation stays above this share of its
#: prior. At a half, three quarters of the estimate's information come from the record.
UNSEEN = 0.5


@dataclass(frozen=True)
class Parameter:
    """A parameter of an adaptive observer, as assumed and as learnt."""

    name: str
    unit: str
    assumed: float
    prior: float
    value: float
    std: float

    @property
    def told(self) -> bool:
        """Whether the log tells it."""
        return self.std <= UNSEEN * self.prior


def parameters(observer: AdaptiveObserver, learnt: Learnt) -> list[Parameter]:
    """The parameters that were unknown."""
    found = (
        Parameter(
            *("magnet flux", "Wb", observer.psi_f, observer.psi_f_std),
            *(learnt.psi_f, learnt.psi_f_std),
        ),
        Parameter(
            *("resistance", "Ω", observer.resistance, observer.resistance_std),
            *(learnt.resistance, learnt.resistance_std),
        ),
        Parameter(
            *("inverter", "V", observer.inverter_voltage, observer.inverter_std),
            *(learnt.inverter_voltage, learnt.inverter_std),
        ),
    )
    return [one for one in found if one.prior > 0]


def learn(
    run: Prepared, observer: AdaptiveObserver, tell: Callable[[int], Any]
) -> tuple[CompiledState, Learnt]:
    """Run over the whole log; returns a state that keeps what was learnt as it is."""
    state = observer.init()
    for part in ahead(run.log.aligned(size=run.batch)):
        state, _ = observer.resume(state, part.voltage, part.current)
        tell(len(part.t))
    return observer.restart(state, frozen=True), observer.learnt(state)
