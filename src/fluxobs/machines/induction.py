"""Induction machine with a cage."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import model_validator

from .. import _core
from ..core.arrays import Array
from ..core.validation import NotNegative, Positive
from .contract import Position
from .datasheet import from_datasheet
from .model.constraint import QuadraticConstraint
from .model.flux_map import CageMap, FluxMap
from .rotating import RotatingMachine

#: Parameters of the T-model, from a datasheet or from no-load and locked-rotor tests.
T_MODEL = ("R_r", "L_ls", "L_lr", "L_m")
#: Numbers on the rating plate, in its units: V rms (line to line), A rms (line), Hz, W, rpm.
PLATE = ("voltage", "frequency", "power", "current", "speed", "cos_phi")
#: Leakage reactance divided by the rated impedance, used if only the plate is known. The ratio is
#: 0.12 to 0.2 in machines of 1 to 100 kW.
LEAKAGE = 0.15
#: Magnetizing current divided by the rated current, used if neither current is given. The ratio is
#: 0.3 in large and 0.6 in small machines.
MAGNETIZING: float = _core.usual["MAGNETIZING"]
#: The rotor flux counts as constant below this change of i_d, divided by the magnetizing current.
#: The limit is five times the effect of usual current offsets (2 % of rated), and less than any
#: field weakening.
STILL: float = _core.usual["STILL"]
#: Std of a current offset, divided by the rated current.
OFFSET: float = _core.usual["CAGE_OFFSET"]


class InductionMachine(RotatingMachine):
    """Cage induction machine in its inverse-Γ model; the position is the rotor flux angle.

    With the stator flux λ, the rotor flux is ``x = λ - L_sigma i``, and ``dx/dt = R_R i - (R_R/L_M
    - j n_p ω_m) x``. At any speed, the length of x obeys ``d|x|/dt = R_R i_d - R_R/L_M |x|``. The
    rotor flux turns faster than the rotor by the slip ``R_R i_q/|x|``.

    Parameters
    ----------
    R_s, n_p, rated_current, rated_speed
        See :class:`RotatingMachine`.
    R_R : float
        Rotor resistance [Ω], > 0. R_R affects the mechanical speed, and the position while the
        rotor flux changes.
    L_sigma, L_M : float
        Leakage and magnetizing inductance [H], > 0.
    psi_R : float, optional
        Rated rotor flux [Wb]; only a scale. Default: 0.45 L_M rated_current.
    R_R_std, L_sigma_std : float, optional
        Standard deviations [Ω], [H]; default 30 % and 10 %.
    R_r, L_ls, L_lr, L_m : float, instead of R_R, L_sigma, L_M
        T-model parameters, referred to the stator.
    plate : mapping, instead of all inductances and resistances
        voltage [V rms, line to line], frequency [Hz], power [W], current [A rms], speed [rpm],
        cos_phi, for a star connection. These numbers give rough values, which `fluxobs identify`
        improves. The leakage reactance is 0.15 of the rated impedance, and all losses except those
        of the slip are assigned to the stator's copper.

    References
    ----------
    G. R. Slemon, "Modelling of induction machines for electric drives", IEEE Trans. Ind. Appl. 25
    (1989), doi:10.1109/28.44251 (inverse-Γ); docs/theory.md, section 15.
    """

    kind = "induction"
    inductances = ("L_sigma", "L_sigma")
    magnets = True
    flux_moves = True
    flux_name = "psi_R"
    length_name = "Rotor flux"
    position_output = Position(
        "theta_e", ("theta_e",), 180 / np.pi, "°", "Electrical angle of the rotor flux"
    )

    R_R: Positive
    L_sigma: Positive
    L_M: Positive
    psi_R: Positive | None = None
    R_R_std: NotNegative | None = None
    L_sigma_std: NotNegative | None = None

    @model_validator(mode="before")
    @classmethod
    def _convert(cls, fields: Any) -> Any:
        if not isinstance(fields, dict):
            return fields
        values = from_datasheet(fields, cls.inductances, magnets=False)
        plate = values.pop("plate", None)
        if plate is not None:
            values = from_plate(plate) | values
        missing = [name for name in T_MODEL if name not in values]
        if len(missing) < len(T_MODEL):
            if missing:
                raise ValueError(f"the T-model needs {', '.join(T_MODEL)}: {missing[0]} is missing")
            values |= from_t_model(
                **{name: _check_positive(name, values.pop(name)) for name in T_MODEL}
            )
        return values

    @property
    def magnet_flux(self) -> float | None:
        return self.flux_base(1.0) if self.psi_R or self.rated_current else None

    @property
    def magnetizing_current(self) -> float:
        return (self.magnet_flux or 0.0) / self.L_M

    @property
    def constraint(self) -> QuadraticConstraint:
        L, eye = self.L_sigma, np.eye(2)
        return QuadraticConstraint(
            eye, -2 * L * eye, L * L * eye, d=-((self.magnet_flux or 0.0) ** 2)
        )

    def flux_base(self, rated_current: float, psi_f: float | None = None) -> float | None:
        if psi_f is not None or self.psi_R is not None:
            return psi_f or self.psi_R
        return MAGNETIZING * self.L_M * (self.rated_current or rated_current)

    def constraint_noise(self, flux_base: float, noise: float) -> float:
        return 2 * self.L_sigma * flux_base * noise

    def map_for(self, sample_time: float, psi_f: float) -> FluxMap | None:
        still = STILL * psi_f / self.L_M
        offset = OFFSET * (self.rated_current or psi_f / (MAGNETIZING * self.L_M))
        return CageMap(self.L_sigma, self.L_M, self.R_R, sample_time, psi_f, still, offset)

    def slip(self, flux: Array, current: Array) -> Array:
        """Return the electrical speed [rad/s] of the rotor flux relative to the rotor."""
        x = np.asarray(flux) - self.L_sigma * np.asarray(current)
        cross = x[..., 0] * current[..., 1] - x[..., 1] * current[..., 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(self.R_R * cross / np.sum(x * x, axis=-1))

    @property
    def slip_share_std(self) -> float:
        """Relative standard deviation of the slip, which equals that of R_R."""
        return ROTOR_SHARE if self.R_R_std is None else self.R_R_std / self.R_R


#: Default of R_R_std divided by R_R. Heat alone changes R_R by ± 20 %.
ROTOR_SHARE = 0.3


def from_t_model(R_r: float, L_ls: float, L_lr: float, L_m: float) -> dict[str, float]:
    """Return R_R, L_sigma, L_M of the inverse-Γ model with the same impedance at the terminals."""
    k = L_m / (L_lr + L_m)
    return {"R_R": k * k * R_r, "L_sigma": L_ls + k * L_lr, "L_M": k * L_m}


def from_plate(plate: object) -> dict[str, Any]:
    """Estimate all parameters roughly from the rating plate."""
    if not isinstance(plate, Mapping) or set(plate) != set(PLATE):
        raise ValueError(f"plate needs {', '.join(PLATE)} [V rms, Hz, W, A rms, rpm, 1]")
    V, f, P, I_rms, n, cos_phi = (_check_positive(f"plate.{name}", plate[name]) for name in PLATE)
    if not cos_phi < 1:
        raise ValueError(f"plate.cos_phi must be below 1, got {cos_phi:g}")
    n_p = int(60 * f / n)
    slip = 1 - n * n_p / (60 * f)
    if n_p < 1 or not 0 < slip < 0.2:
        raise ValueError(
            f"plate.speed {n:g} rpm and frequency {f:g} Hz give no slip between 0 and 20 %: the "
            f"rated speed is a little below 60 f/n_p"
        )
    omega = 2 * np.pi * f
    u, i = V * np.sqrt(2 / 3), I_rms * np.sqrt(2) * complex(cos_phi, -np.sqrt(1 - cos_phi**2))
    gap_power = P / (1 - slip)
    electrical_power = 1.5 * u * i.real
    if not gap_power < electrical_power:
        raise ValueError(
            f"plate: {P:g} W at the shaft need {gap_power:.4g} W across the air gap, more than "
            f"the {electrical_power:.4g} W that voltage, current and cos_phi give"
        )
    R_s = (electrical_power - gap_power) / (1.5 * abs(i) ** 2)
    L_sigma = LEAKAGE * u / abs(i) / omega
    x = (u - (R_s + 1j * omega * L_sigma) * i) / (1j * omega)
    i_dq = i * abs(x) / x
    values = {
        "R_s": R_s,
        "R_R": slip * omega * abs(x) / i_dq.imag,
        "L_sigma": L_sigma,
        "L_M": abs(x) / i_dq.real,
        "psi_R": abs(x),
        "rated_current": abs(i),
        "rated_speed": n * np.pi / 30,
    }
    return {name: float(f"{value:.4g}") for name, value in values.items()} | {"n_p": n_p}


def _check_positive(name: str, value: object) -> float:
    """Return a positive finite number as float; raise ValueError for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < np.inf:
        raise ValueError(f"{name} must be a positive number, got {value!r}")
    return float(value)
