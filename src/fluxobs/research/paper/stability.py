"""Stability of Proposition 2 on the levitation: Floquet multipliers or Lyapunov exponents.

S2, S3 and S5 settle to a periodic orbit, where Floquet multipliers decide. S1 does not settle,
because its flux decreases without bias flux. The exponent of S1 is that of the record; the
uncertainty shows how far this exponent holds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.arrays import Array
from ..analysis import excitation, large_gain_sum, over_gain, small_gain_rates
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

#: Factors by which the printed gain matrix of Proposition 2 is multiplied.
FACTORS = (0.01, 1.0, 10.0)
#: Scalar gains of the counter-example on S5.
SCALAR_GAINS = tuple(10.0**k for k in range(-5, 7))
#: Units of the drift, relative to the unit in which its regressor has rms one. The last unit is one
#: flux unit per second.
UNITS = (1.0, 0.5, 0.3, 0.155)
#: Time omitted at the start of each span. Unit s; filters and slow poles have transients.
AFTER_START = 2.0


@dataclass(frozen=True)
class Growth:
    """Growth rate of Proposition 2's error before and after the jump, for each factor.

    Attributes
    ----------
    period : float or None
        Period of the orbit [s]; None without an orbit.
    attracts : float or None
        Largest |Floquet multiplier| of the closed loop on the orbit; the orbit attracts below one.
    before, after : dict
        Gain factor → (exponent, uncertainty) [1/s].
    limits : dict
        "before" or "after" → (largest exponent over √γ at small gain [s^-1], sum of the finite
        exponents at large gain [1/s]), in closed form.
    """

    period: float | None
    attracts: float | None
    before: dict[str, tuple[float, float]]
    after: dict[str, tuple[float, float]]
    limits: dict[str, tuple[float, float]]


def printed_constants() -> Parametrisation:
    """Return the paper's seven unknowns: λ, θ, Q2 δ_i, 2/ν θᵀQ1θ."""
    return Parametrisation(benchmark()[0].constraint, "printed", CORNER)


def psi_on_orbit(name: str, segment: int) -> tuple[Array, float]:
    """Return (Ψ of a scenario's periodic steady state, its sample time)."""
    measured, _ = measured_orbit(name, segment)
    rows = periodic_regression(benchmark()[0].constraint, CORNER, measured)
    psi = np.asarray(printed_constants().psi_record(rows))
    return psi, measured.period / len(psi)


def growth(record: LevitationRecord, rows: Regressors) -> Growth:
    """Return the exponents of a scenario from its orbit or, without an orbit, from the record."""
    name, constants = record.scenario.name, printed_constants()
    has_orbit = record.scenario.bias_current > 0
    rates, limits, gain = [], {}, np.array(ADAPTIVE_GAIN)
    for segment, (when, start, stop) in enumerate(
        (
            ("before", 0.0, record.jump),
            ("after", record.jump, float(record.t[-1]) + record.h),
        )
    ):
        if has_orbit:
            psi, h = psi_on_orbit(name, segment)
        else:
            inside = (record.t > start + AFTER_START) & (record.t < stop - record.h / 2)
            span = rows.part(inside)
            psi, h = np.asarray(constants.psi_record(span)), record.h
        study = over_gain(psi, h, constants, FACTORS, gain, has_orbit)
        limits[when] = (
            float(small_gain_rates(psi, constants, gain)[0].real),
            large_gain_sum(psi, constants, gain),
        )
        rates.append(
            {
                f"{gain:g}": (float(value), float(error))
                for gain, value, error in zip(
                    study.gains, study.exponent, study.uncertainty, strict=True
                )
            }
        )
    if not has_orbit:
        return Growth(None, None, rates[0], rates[1], limits)
    attracts = float(np.abs(orbit(name).multipliers).max())
    return Growth(SCENARIOS[name].period, attracts, rates[0], rates[1], limits)


@dataclass(frozen=True, eq=False)
class ScalarGain:
    """S5 with a scalar gain in Proposition 2, in units in which every regressor has rms one.

    Attributes
    ----------
    alpha : float
        Smallest eigenvalue of the mean of ``Ψ Ψᵀ`` over the period 2π s. If it is > 0, Ψ is
        persistently exciting.
    gains : (k,) ndarray
    multipliers : dict
        Relative unit of the drift (1: its regressor has rms one) → largest |Floquet multiplier| for
        each gain before the jump. The proposition does not depend on units.
    """

    alpha: float
    gains: Array
    multipliers: dict[float, Array]


def unit_regressor(psi: Array, drift_unit: float = 1.0) -> tuple[Array, Array]:
    """Return (Ψ in units in which every column has rms one, these units).

    `drift_unit` multiplies the unit of the drift; a value below one makes the column smaller.
    """
    units = 1 / np.sqrt(np.mean(psi**2, axis=0))
    units[2:4] *= drift_unit
    return psi * units, units


def scalar_gain() -> ScalarGain:
    """Return the strongest counter-example, with the paper's own levitation, regressor and gain."""
    psi, h = psi_on_orbit("S5", 0)
    constants, multipliers = printed_constants(), {}
    for unit in UNITS:
        _, units = unit_regressor(psi, unit)
        # γ I in these units equals γ diag(units²) in SI units.
        study = over_gain(psi, h, constants, SCALAR_GAINS, units**2)
        multipliers[unit] = study.multipliers(SCENARIOS["S5"].period)
    scaled, _ = unit_regressor(psi)
    mean = excitation(np.vstack([scaled, scaled[:1]]), h, h * len(psi)).alpha / (h * len(psi))
    return ScalarGain(mean, np.array(SCALAR_GAINS), multipliers)
