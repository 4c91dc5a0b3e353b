"""Stability of Proposition 2 on the levitation: multipliers on the orbits, exponents without one.

S2, S3 and S5 settle to a periodic orbit, on which Floquet multipliers decide. S1 does not: without
bias flux its flux fades. Its exponent belongs to the record, and its uncertainty says how far.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.arrays import Array
from ..analysis import excitation, over_gain
from ..regression import Parametrisation, Regressors, periodic_regression
from .levitation import (
    ADAPTIVE_GAIN,
    CORNER,
    SCENARIOS,
    LevitationRecord,
    benchmark,
    measured_orbit,
    orbit,
)

#: Gain factors on the printed matrix of Proposition 2.
FACTORS = (0.01, 1.0, 10.0)
#: Scalar gains of the counter-example on S5.
SCALAR_GAINS = tuple(10.0**k for k in range(-5, 7))
#: Units of the drift, over the one that gives its regressor rms one; the last is one unit of flux
#: per second.
UNITS = (1.0, 0.5, 0.3, 0.155)
#: Time left out at the start of each span: the filters, and the slow poles of the loop [s].
AFTER_START = 2.0


@dataclass(frozen=True)
class Growth:
    """Growth rate of the error of Proposition 2, before and after the jump, for each factor.

    Attributes
    ----------
    period : float or None
        Of the orbit [s]; None if there is none.
    attracts : float or None
        Largest |Floquet multiplier| of the closed loop on the orbit: below one it is reached.
    before, after : dict
        Gain factor → (exponent, uncertainty) [1/s].
    """

    period: float | None
    attracts: float | None
    before: dict[str, tuple[float, float]]
    after: dict[str, tuple[float, float]]


def printed_constants() -> Parametrisation:
    """The paper's seven unknowns: λ, θ, Q2 δ_i, 2/ν θᵀQ1θ."""
    return Parametrisation(benchmark()[0].constraint, "printed", CORNER)


def psi_on_orbit(name: str, segment: int) -> tuple[Array, float]:
    """Ψ of a scenario's periodic steady state, and its sample time."""
    measured, _ = measured_orbit(name, segment)
    rows = periodic_regression(benchmark()[0].constraint, CORNER, measured)
    psi = np.asarray(printed_constants().psi_record(rows))
    return psi, measured.period / len(psi)


def growth(given: LevitationRecord, rows: Regressors) -> Growth:
    """Exponents of a scenario, from its orbit or, without one, from the record."""
    name, constants = given.scenario.name, printed_constants()
    has_orbit = given.scenario.bias_current > 0
    parts = []
    for segment, (start, stop) in enumerate(
        ((0.0, given.jump), (given.jump, float(given.t[-1]) + given.h))
    ):
        if has_orbit:
            psi, h = psi_on_orbit(name, segment)
        else:
            inside = (given.t > start + AFTER_START) & (given.t < stop - given.h / 2)
            used = rows.part(inside)
            psi, h = np.asarray(constants.psi_record(used)), given.h
        study = over_gain(psi, h, constants, FACTORS, np.array(ADAPTIVE_GAIN), has_orbit)
        parts.append(
            {
                f"{gain:g}": (float(value), float(error))
                for gain, value, error in zip(
                    study.gains, study.exponent, study.uncertainty, strict=True
                )
            }
        )
    if not has_orbit:
        return Growth(None, None, *parts)
    attracts = float(np.abs(orbit(name).multipliers).max())
    return Growth(SCENARIOS[name].period, attracts, *parts)


@dataclass(frozen=True, eq=False)
class ScalarGain:
    """S5 with the scalar gain of Proposition 2, unknowns in units that give unit regressors.

    Attributes
    ----------
    alpha : float
        Smallest eigenvalue of the mean of ``Ψ Ψᵀ`` over the period, 2π s: persistently exciting.
    gains : (k,) ndarray
    multipliers : dict
        Unit of the drift, over the one that makes its regressor's rms one → largest |Floquet
        multiplier| for each gain, before the jump. The proposition does not depend on units.
    """

    alpha: float
    gains: Array
    multipliers: dict[float, Array]


def unit_regressor(psi: Array, drift_unit: float = 1.0) -> tuple[Array, Array]:
    """Ψ in units in which every column's rms is one, and those units.

    `drift_unit` divides the unit of the drift, so that its column becomes smaller.
    """
    units = 1 / np.sqrt(np.mean(psi**2, axis=0))
    units[2:4] *= drift_unit
    return psi * units, units


def scalar_gain() -> ScalarGain:
    """The strongest counter-example: the paper's own levitation, regressor and kind of gain."""
    psi, h = psi_on_orbit("S5", 0)
    constants, found = printed_constants(), {}
    for unit in UNITS:
        _, units = unit_regressor(psi, unit)
        # γ I in these units is γ diag(units²) in SI.
        study = over_gain(psi, h, constants, SCALAR_GAINS, units**2)
        found[unit] = study.multipliers(SCENARIOS["S5"].period)
    scaled, _ = unit_regressor(psi)
    mean = excitation(np.vstack([scaled, scaled[:1]]), h, h * len(psi)).alpha / (h * len(psi))
    return ScalarGain(mean, np.array(SCALAR_GAINS), found)
