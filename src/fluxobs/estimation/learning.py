"""The first pass over a recorded log: the adaptive observer learns its parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.output import ahead
from ..logs.log import Log
from ..logs.scales import Scales
from ..machines import RotatingMachine
from ..observers import AdaptiveObserver
from ..observers.adaptive import Learnt
from ..observers.compiled import CompiledState
from ..observers.for_log import Prepared

#: A parameter is identifiable if its standard deviation falls below this share of the prior
#: standard deviation. At one half, three quarters of the estimate's information come from the
#: record.
UNSEEN = 0.5
#: Number of segments from which to learn in a longer log, and their rows: a minute at 20 kHz in
#: all. More rows do not help, since the smoother refines the parameters.
SEGMENTS, SEGMENT_ROWS = 12, 131_072
#: A residual below this share of the flux squared is accepted: measured logs with correct machine
#: data and settings reach 0.3 to 0.8 % (benchmarks/measured.py).
RESIDUAL_LIMIT = 0.01
#: A residual below this multiple of the noise is accepted too.
NOISE_FACTOR = 3.0


@dataclass(frozen=True)
class Parameter:
    """A parameter of an adaptive observer: assumed value and learnt value."""

    name: str
    unit: str
    assumed: float
    prior: float
    value: float
    std: float

    @property
    def told(self) -> bool:
        """Whether the log identifies the parameter."""
        return self.std <= UNSEEN * self.prior


def parameters(observer: AdaptiveObserver, learnt: Learnt) -> list[Parameter]:
    """Return the parameters that were estimated: those with a prior standard deviation."""
    candidates = (
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
    return [parameter for parameter in candidates if parameter.prior > 0]


def learning_segments(log: Log) -> list[tuple[int, int]]:
    """Return (first row, end row) of each segment from which parameters are learnt.

    A short log is one segment; the segments of a long log are evenly spread.
    """
    if len(log) <= SEGMENTS * SEGMENT_ROWS or not log.table.random_access:
        return [(log.first, log.last)]
    starts = np.linspace(log.first, log.last - SEGMENT_ROWS, SEGMENTS).astype(int)
    return [(int(start), int(start) + SEGMENT_ROWS) for start in starts]


def learn(
    run: Prepared, observer: AdaptiveObserver, count_rows: Callable[[int], Any]
) -> tuple[CompiledState, Learnt]:
    """Run over the log; return a state with fixed learnt parameters, and the parameters."""
    state = observer.init()
    for n, (start, end) in enumerate(learning_segments(run.log)):
        if n > 0:
            state = observer.restart(state)
        for batch in ahead(run.aligned(start, end)):
            state, _ = observer.resume(state, batch.voltage, batch.current)
            count_rows(len(batch.t))
    return observer.restart(state, frozen=True), observer.learnt(state)


def doubtful(residual: float, machine: RotatingMachine, flux: float, scales: Scales) -> bool:
    """Whether noise cannot explain a residual, which is a share of the flux squared."""
    noise = machine.constraint_noise(flux, scales.current_noise) / flux**2
    return not residual < max(RESIDUAL_LIMIT, NOISE_FACTOR * noise)
