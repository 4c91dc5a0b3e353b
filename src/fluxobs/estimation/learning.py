"""The first pass over a recorded log: what it tells about the parameters, and which to take."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.output import ahead
from ..logs.log import Log
from ..logs.scales import Scales, excerpts
from ..machines import RotatingMachine
from ..observers import AdaptiveObserver, LeastSquaresObserver
from ..observers.adaptive import Learnt
from ..observers.compiled import CompiledState
from ..observers.for_log import Prepared

#: Nothing was learnt about a parameter whose standard deviation stays above this share of its
#: prior. At a half, three quarters of the estimate's information come from the record.
UNSEEN = 0.5
#: A longer log is learnt from so many parts of so many rows, ten minutes at 20 kHz: by then, what
#: changes slowly limits what is known, not the number of rows.
PARTS, PART_ROWS = 12, 1_000_000
#: A value within this many standard deviations of what was given agrees with it.
AGREES = 3.0
#: A residual below this share of the flux squared is no cause for doubt: measured logs with correct
#: machine data and settings reach 0.3 to 0.8 % (benchmarks/measured.py).
RESIDUAL_LIMIT = 0.01
#: Nor is a residual below this many times what noise explains.
NOISE_FACTOR = 3.0


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


def learning_parts(log: Log) -> list[tuple[int, int]]:
    """First and last row of the parts of a log from which parameters are learnt: all of it, or
    evenly spread parts of a long one."""
    if len(log) <= PARTS * PART_ROWS or not log.table.random_access:
        return [(log.first, log.last)]
    starts = np.linspace(log.first, log.last - PART_ROWS, PARTS).astype(int)
    return [(int(start), int(start) + PART_ROWS) for start in starts]


def learn(
    run: Prepared, observer: AdaptiveObserver, tell: Callable[[int], Any]
) -> tuple[CompiledState, Learnt]:
    """Run over the log; returns a state that keeps what was learnt as it is."""
    state = observer.init()
    for n, (first, last) in enumerate(learning_parts(run.log)):
        if n > 0:
            state = observer.restart(state)
        for part in ahead(run.log.aligned(first, last, run.batch)):
            state, _ = observer.resume(state, part.voltage, part.current)
            tell(len(part.t))
    return observer.restart(state, frozen=True), observer.learnt(state)


def needed(observer: AdaptiveObserver, learnt: Learnt, plain: Prepared) -> bool:
    """Whether a log asks for the adaptive observer: whether it tells the resistance or the
    inverter, and either they are not as given or the plain observer's residual is not noise."""
    found = [one for one in parameters(observer, learnt) if one.name != "magnet flux"]
    if not any(one.told for one in found):
        return False
    agree = all(abs(one.value - one.assumed) < AGREES * one.std for one in found)
    return not (agree and _fits(plain))


def _fits(plain: Prepared) -> bool:
    """Whether noise explains the residual of the plain observer, in excerpts of the log."""
    observer, machine = plain.observer, plain.machine
    assert isinstance(observer, LeastSquaresObserver)
    assert isinstance(machine, RotatingMachine)
    squares, rows, lengths = 0.0, 0, []
    for part in excerpts(plain.log):
        found = observer.run(part.voltage, part.current)
        if not found.valid.any():
            return False
        since = slice(int(np.argmax(found.valid)), None)
        squares += float((found.innovation[since] ** 2).sum())
        rows += len(found.innovation[since])
        lengths.append(float(found.psi_f[found.valid].mean()))
    flux = float(np.mean(lengths)) if machine.magnets else observer.flux_base
    residual = np.sqrt(squares / rows) * observer.constraint_noise / flux**2
    return not doubtful(residual, machine, flux, plain.scales)


def doubtful(residual: float, machine: RotatingMachine, flux: float, scales: Scales) -> bool:
    """Whether a residual, as a share of the flux squared, is more than noise explains."""
    noise = machine.constraint_noise(flux, scales.current_noise) / flux**2
    return not residual < max(RESIDUAL_LIMIT, NOISE_FACTOR * noise)
