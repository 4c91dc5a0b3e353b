"""Erratum 6: persistently excited, and Proposition 2 is unstable at every gain."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ..design.analysis import GainStudy, excitation, over_gain
from ..design.analysis.stability import proposition_2
from ..design.regression import Parametrisation, Regressors
from ..design.regression.laws import (
    FluxObserver,
    PrintedAdaptiveObserver,
    RepairedAdaptiveObserver,
    run,
)
from .pmsm import counter_example as trajectory

Array = NDArray[np.float64]

GAINS = tuple(10.0**k for k in range(-3, 5))
#: Samples a period of the analysis; of the runs it is thinned by THIN.
SAMPLES, THIN = 2000, 1
PERIODS = 30


@dataclass(frozen=True, eq=False)
class CounterExample:
    """Attributes
    ----------
    alpha : float
        Smallest eigenvalue of ``∫ Ψ Ψᵀ`` over a period: persistently exciting.
    study : GainStudy
        Largest |Floquet multiplier| over the gain.
    errors : dict
        Law → |λ̂ - λ| at the end of each period.
    """

    alpha: float
    study: GainStudy
    errors: dict[str, Array]


def study() -> CounterExample:
    """Multipliers, and the printed and the repaired law from zero over thirty periods."""
    given = trajectory(SAMPLES)
    constants = Parametrisation(given.constraint, "voltage-bias", 1.0)
    psi, _, _ = proposition_2(given.rows, constants)
    alpha = excitation(np.asarray(psi), given.h, 2 * np.pi - given.h).alpha
    multipliers = over_gain(given.rows, constants, given.h, GAINS)

    # The same period over and over; rows 1 … of it, since row 0 is the last one again.
    step = THIN * given.h
    rows = Regressors(
        *(jnp.tile(part[THIN::THIN], (PERIODS, *[1] * (part.ndim - 1))) for part in given.rows)
    )
    flux = np.tile(given.flux[THIN::THIN], (PERIODS, 1))
    v = jnp.asarray(np.diff(flux, axis=0, prepend=flux[-1:]))
    period = SAMPLES // THIN

    def errors(observer: FluxObserver) -> Array:
        found, _ = run(observer, step, v, rows)
        error = np.linalg.norm(np.asarray(found) - flux, axis=1)
        return np.asarray(np.r_[np.linalg.norm(flux[0]), error[period - 1 :: period]])

    return CounterExample(
        alpha,
        multipliers,
        {
            "printed, γ_a = 1": errors(PrintedAdaptiveObserver(1.0, constants)),
            "repaired, Γ = G = 1": errors(RepairedAdaptiveObserver(1.0, 1.0, constants)),
            "repaired, Γ = 100, G = 1": errors(RepairedAdaptiveObserver(100.0, 1.0, constants)),
        },
    )
