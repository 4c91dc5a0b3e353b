"""Erratum 6: Ψ is persistently exciting, but Proposition 2 is unstable at every gain."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from ...core.arrays import Array
from ..analysis import over_gain
from ..regression import Parametrisation
from ..regression.laws import (
    ContinuousObserver,
    PrintedAdaptiveObserver,
    RepairedAdaptiveObserver,
    integrate_law,
)
from .pmsm import counter_example as trajectory

GAINS = tuple(10.0**k for k in range(-3, 5))
#: Samples per period for the multipliers; steps per period for the runs.
SAMPLES, STEPS = 256, 4000
PERIODS = 30


@dataclass(frozen=True, eq=False)
class CounterExample:
    """The counter-example in numbers.

    Attributes
    ----------
    alpha : float
        Smallest eigenvalue of ``∫ Ψ Ψᵀ`` over a period; Ψ is persistently exciting if it is > 0.
    gains, multipliers : ndarray
        Largest |Floquet multiplier| for each gain.
    errors : dict
        Law → |λ̂ - λ| at the end of each period.
    """

    alpha: float
    gains: Array
    multipliers: Array
    errors: dict[str, Array]


def study() -> CounterExample:
    """Compute the multipliers and run the printed and repaired laws for 30 periods, from zero."""
    coarse = trajectory(SAMPLES)
    constants = Parametrisation(coarse.constraint, "voltage-bias", 1.0)
    psi = np.asarray(constants.psi_record(coarse.rows))
    alpha = float(np.linalg.eigvalsh(coarse.h * psi.T @ psi)[0])
    stability = over_gain(psi, coarse.h, constants, GAINS)

    # Two samples per step. The first sample of a period is the last sample of the previous period.
    fine = trajectory(2 * STEPS)
    count = np.arange(2 * STEPS * PERIODS + 1) % (2 * STEPS)
    rows = fine.rows.part(count)
    y_m = jnp.asarray(fine.orbit.y_m[count])

    def errors(observer: ContinuousObserver) -> Array:
        estimates, _ = integrate_law(observer, 2 * fine.h, y_m, rows)
        return np.asarray(np.linalg.norm(np.asarray(estimates)[::STEPS] - fine.flux[0], axis=1))

    return CounterExample(
        alpha,
        stability.gains,
        stability.multipliers(2 * np.pi),
        {
            "printed, γ_a = 1": errors(PrintedAdaptiveObserver(1.0, constants)),
            "repaired, Γ = G = 1": errors(RepairedAdaptiveObserver(1.0, 1.0, constants)),
            "repaired, Γ = 100, G = 1": errors(RepairedAdaptiveObserver(100.0, 1.0, constants)),
        },
    )
