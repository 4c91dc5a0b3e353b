"""The relation between flux and current as residuals of a log, with derivatives.

Each relation gives for the rows of a piece the residual, its derivatives by flux and by its own
parameters, with the angle eliminated (docs/theory.md, sections 13 and 14).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array
from ..machines import AlgebraicSaturation
from ..machines.model.flux_map import FluxMap

Complex = NDArray[np.complex128]

#: Rounds in which an angle is refined: each takes an error to the square of it, or nearly.
ROUNDS = 6
#: Largest step of an angle in a round [rad].
LARGEST = 0.3
#: Share by which a cage's parameters are moved for their derivatives.
STEP = 1e-4


@dataclass(frozen=True, eq=False)
class Linearisation:
    """What a relation says of rows.

    Attributes
    ----------
    residual : (rows,) ndarray
        [Wb].
    to_flux : (rows,) complex ndarray
        Its derivative by the flux: change = Re(conj(to_flux) dλ).
    by_name : dict of str to (rows,) ndarray
        Its derivatives by the relation's parameters.
    current : (rows,) complex ndarray
        i_d + j i_q [A].
    to_start : (rows,) complex ndarray, optional
        Derivative of the residual by the flux of the first row, beyond that by its own.
    """

    residual: Array
    to_flux: Complex
    by_name: dict[str, Array]
    current: Complex
    to_start: Complex | None = None


class ResidualFunction(Protocol):
    """How flux and current fit together."""

    def __call__(
        self, flux: Complex, current: Complex, values: Mapping[str, float]
    ) -> Linearisation:
        """Residual and derivatives at these values [Wb], [A], of all rows."""
        ...


def linear(flux: Complex, current: Complex, values: Mapping[str, float]) -> Linearisation:
    """Constant inductances: ``|x| - ψ - (L_d - L_q) i_d``, x = λ - L_q i."""
    x = flux - values["L_q"] * current
    length = np.abs(x)
    direction = x / length
    i_d = (direction.conj() * current).real
    saliency = values["L_d"] - values["L_q"]
    to_flux = direction - saliency * (current - i_d * direction) / length
    by_current = (to_flux.conj() * current).real
    by_name = {
        "psi_f": -np.ones(len(current)),
        "L_s": -(direction.conj() * current).real,
        "L_d": -i_d,
        "L_q": i_d - by_current,
    }
    return Linearisation(
        length - values["psi_f"] - saliency * i_d, to_flux, by_name, current * direction.conj()
    )


@dataclass(frozen=True, eq=False)
class Mapped:
    """A flux map: ``|x| - a_d``, x = λ - e^{jφ}(F - a_d), with the auxiliary flux a.

    Another magnet flux than the map's adds to F. `L_q` is where the angle starts.
    """

    flux_map: FluxMap
    psi_f: float

    def __call__(
        self, flux: Complex, current: Complex, values: Mapping[str, float]
    ) -> Linearisation:
        x, i, a = self.flux_map.position_vector(flux, current, values["L_q"])
        length = np.abs(x)
        direction = x / length
        residual = length - np.abs(a.real) - (values["psi_f"] - self.psi_f)
        lean = a.imag / np.where(np.abs(a.real) > 1e-9, a.real, np.inf)
        to_flux = direction * (1 + 1j * lean)
        return Linearisation(residual, to_flux, {"psi_f": -np.ones(len(current))}, i)


#: Parameters of the algebraic model that a log may tell.
SATURATION = ("a_d0", "a_dd", "a_q0", "a_qq", "a_dq")


@dataclass(frozen=True)
class Saturating:
    """The algebraic model with free parameters: what is left of ``i - e^{jφ} I(e^{-jφ} λ)`` across
    its own change with φ, times L_q.

    `model` holds the exponents; `L_q` is where the angle starts.
    """

    model: AlgebraicSaturation

    def with_values(self, values: Mapping[str, float]) -> AlgebraicSaturation:
        """The model with the parameters of a fit."""
        names = (*SATURATION, *(("psi_f",) if self.model.psi_f > 0 else ()))
        return AlgebraicSaturation.model_construct(
            **self.model.model_dump() | {name: values[name] for name in names}
        )

    @staticmethod
    def _at(
        model: AlgebraicSaturation, psi: Complex, current: Complex
    ) -> tuple[tuple[Array, ...], Complex, Complex]:
        """Slopes of the model; the derivative of ``e^{jφ} I(e^{-jφ} λ)`` by φ, j I - I'(j ψ); and
        what is left of the current. All in rotor coordinates."""
        i, slopes = model.current(psi), model.slopes(psi)
        (dd, dq, qq), d, q = slopes, psi.real, psi.imag
        g = 1j * i - ((-dd * q + dq * d) + 1j * (-dq * q + qq * d))
        return slopes, g, current - i

    def __call__(
        self, flux: Complex, current: Complex, values: Mapping[str, float]
    ) -> Linearisation:
        model = self.with_values(values)
        x = flux - values["L_q"] * current
        direction = x / np.abs(x)
        for _ in range(ROUNDS):
            _, g, left = self._at(model, flux * direction.conj(), current * direction.conj())
            step = (left * g.conj()).real / (np.abs(g) ** 2 + 1e-300)
            direction = direction * np.exp(1j * np.clip(step, -LARGEST, LARGEST))
        psi = flux * direction.conj()
        (dd, dq, qq), g, left = self._at(model, psi, current * direction.conj())
        n = 1j * g / (np.abs(g) + 1e-300)
        # In flux units by one inductance for all rows: currents have the same noise in all of them.
        across = -n * values["L_q"]
        residual = (left * across.conj()).real
        # a flux across x acts as n' I' on the current
        to = n.real * dd + n.imag * dq + 1j * (n.real * dq + n.imag * qq)
        to_flux = direction * to * values["L_q"]

        def by(change: NDArray[np.complexfloating]) -> Array:
            return -(change * across.conj()).real

        d, q = psi.real, psi.imag
        absolute_d, absolute_q = np.abs(d), np.abs(q)
        S, T, U, V = model.S, model.T, model.U, model.V
        magnet = model.psi_f
        cross = absolute_d**U * absolute_q ** (V + 2) * d / (V + 2) + 1j * absolute_d ** (
            U + 2
        ) * absolute_q**V * q / (U + 2)
        by_name = {
            "a_d0": by(d - magnet + 0j),
            "a_dd": by(absolute_d**S * d - magnet ** (S + 1) + 0j),
            "a_q0": by(1j * q),
            "a_qq": by(1j * absolute_q**T * q),
            "a_dq": by(cross),
            "psi_f": by(-(model.a_d0 + (S + 1) * model.a_dd * magnet**S) * np.ones_like(psi)),
        }
        return Linearisation(residual, to_flux, by_name, current * direction.conj())


@dataclass(frozen=True)
class Cage:
    """Rotor flux that follows its equation: ``|x| - ψ``, ``dψ/dt = R_R (i_d - ψ/L_M)``, from |x| of
    the first row on (docs/theory.md, section 15)."""

    sample_time: float

    def __call__(
        self, flux: Complex, current: Complex, values: Mapping[str, float]
    ) -> Linearisation:
        x = flux - values["L_q"] * current
        length = np.abs(x)
        direction = x / length
        i = current * direction.conj()
        first = length[0]
        R_R, L_M = values["R_R"], values["L_M"]
        by_name = {}
        for name in ("R_R", "L_M"):
            more, less = (
                self._flux(i.real, first, **{"R_R": R_R, "L_M": L_M, name: values[name] * factor})
                for factor in (1 + STEP, 1 - STEP)
            )
            by_name[name] = -(more - less) / (2 * STEP * values[name])
        left = np.exp(-R_R / L_M * self.sample_time * np.arange(len(x)))
        by_name["L_s"] = -i.real + left * i.real[0]
        residual = length - self._flux(i.real, first, R_R, L_M)
        return Linearisation(residual, direction, by_name, i, -left * direction[0])

    def _flux(self, i_d: Array, first: float, R_R: float, L_M: float) -> Array:
        """The flux from a first one on; i_d is linear between the rows."""
        from scipy.signal import lfilter  # loaded only where a cage is identified

        stays = float(np.exp(-R_R / L_M * self.sample_time))
        driven = np.concatenate([[first], (1 - stays) * L_M * (i_d[1:] + i_d[:-1]) / 2])
        return np.asarray(lfilter([1.0], [1.0, -stays], driven))
