"""The observers of induction machines, with their usual gains and a grid for tuning.

Usual gains: 0.2 for the damping of the reduced-order observer (motulator). Crossovers, bandwidths
and covariances have no usual values; the values here are right within a small factor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..machines import RotatingMachine
from .baselines.cage import (
    CageKalmanFilter,
    FullOrderObserver,
    HybridFluxObserver,
    ReducedOrderObserver,
)
from .catalogue import CATALOGUE, INJECTION, PLL, Entry, Gains, Setting, baseline

#: Entries of the general catalogue that suit a cage, because they need no known flux magnitude.
SHARED = ("least squares", "voltage model, low-pass", "voltage model, high-pass")


_BY_NAME = {entry.name: entry for entry in CATALOGUE}


def _build_kalman(s: Setting, g: Gains) -> CageKalmanFilter:
    sizes = {"current_noise": s.filter_noise, "speed_size": s.speed_e}
    return CageKalmanFilter(s.motor, s.sample_time, **g, **sizes)


CAGES = [
    *(_BY_NAME[name] for name in SHARED),
    Entry(
        "hybrid (Gopinath, Jansen, Lorenz)",
        baseline(HybridFluxObserver),
        lambda s: {"crossover": 0.03 * s.speed_e, "bandwidth": 4 * PLL},
        lambda s: {
            "crossover": [x * s.speed_e for x in (0.01, 0.03, 0.1, 0.3)],
            "bandwidth": [PLL / 2, PLL, 2 * PLL, 4 * PLL],
        },
    ),
    Entry(
        "full-order, speed-adaptive (Kubota)",
        baseline(FullOrderObserver),
        lambda s: {"gain": 1.0, "bandwidth": 2 * PLL},
        lambda s: {
            "gain": [0.0, 0.3, 1.0, 3.0],
            "bandwidth": [PLL / 2, PLL, 2 * PLL, 4 * PLL],
        },
    ),
    Entry(
        "reduced-order (Hinkkanen)",
        baseline(ReducedOrderObserver),
        lambda s: {"damping": 0.2, "bandwidth": PLL},
        lambda s: {
            "damping": [0.01, 0.03, 0.1, 0.2, 0.5, 1.0],
            "bandwidth": [PLL / 2, PLL, 2 * PLL],
        },
    ),
    replace(_BY_NAME["extended Kalman filter"], build=_build_kalman),
]


def entries_for(machine: RotatingMachine, injection: bool = False) -> Sequence[Entry]:
    """Return the observers that suit a kind of machine, and a record with injection."""
    if machine.flux_moves:
        return CAGES
    return [*CATALOGUE, INJECTION] if injection and machine.saliency != 0 else CATALOGUE
