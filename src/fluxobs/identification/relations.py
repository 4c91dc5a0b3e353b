"""Relations between flux and current: residuals over a log, with derivatives.

For the rows of a segment, a relation returns the residual and its derivatives by the flux and by
the parameters of the relation. The angle is eliminated (docs/theory.md, sections 14 and 15).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array
from ..machines import AlgebraicSaturation

Complex = NDArray[np.complex128]

#: Number of iterations of the angle; convergence is nearly quadratic.
ROUNDS = 6
#: Largest step of the angle in an iteration [rad].
LARGEST = 0.3
#: Relative step of a cage's parameters for numerical derivatives.
STEP = 1e-4


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Residual of a relation, linearised.

    Attributes
    ----------
    residual : (rows,) ndarray
        [Wb].
    to_flux : (rows,) complex ndarray
        Derivative by the flux: the residual changes by Re(conj(to_flux) dλ).
    by_name : dict of str to (rows,) ndarray
        Derivatives by the parameters of the relation.
    current : (rows,) complex ndarray
        i_d + j i_q [A].
    to_start : (rows,) complex ndarray, optional
        Derivative by the flux of the first row, which adds to `to_flux`.
    """

    residual: Array
    to_flux: Complex
    by_name: dict[str, Array]
    current: Complex
    to_start: Complex | None = None


class ResidualFunction(Protocol):
    """A relation between flux and current, as a function."""

    def __call__(
        self, flux: Complex, current: Complex, values: Mapping[str, float]
    ) -> Linearisation:
        """Return residual and derivatives of all rows, from flux [Wb] and current [A]."""
        ...


#: Parameters of the algebraic model that can be identified.
SATURATION = ("a_d0", "a_dd", "a_q0", "a_qq", "a_dq")


@dataclass(frozen=True)
class Saturating:
    """Algebraic saturation model with free parameters.

    The residual is the component of ``i - e^{jφ} I(e^{-jφ} λ)`` perpendicular to its derivative by
    φ, times L_q. `model` contains the exponents; `L_q` gives the initial angle.
    """

    model: AlgebraicSaturation

    def with_values(self, values: Mapping[str, float]) -> AlgebraicSaturation:
        """Return the model with a fit's parameters."""
        names = (*SATURATION, *(("psi_f",) if self.model.psi_f > 0 else ()))
        return AlgebraicSaturation.model_construct(
            **self.model.model_dump() | {name: values[name] for name in names}
        )

    @staticmethod
    def _linearise(
        model: AlgebraicSaturation, psi: Complex, current: Complex
    ) -> tuple[tuple[Array, ...], Complex, Complex]:
        """Return slopes of the model, derivative by φ, and error of the current.

        The derivative of ``e^{jφ} I(e^{-jφ} λ)`` by φ is j I - I'(j ψ). All results are in rotor
        coordinates.
        """
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
            _, g, current_error = self._linearise(
                model, flux * direction.conj(), current * direction.conj()
            )
            step = (current_error * g.conj()).real / (np.abs(g) ** 2 + 1e-300)
            direction = direction * np.exp(1j * np.clip(step, -LARGEST, LARGEST))
        psi = flux * direction.conj()
        (dd, dq, qq), g, current_error = self._linearise(model, psi, current * direction.conj())
        n = 1j * g / (np.abs(g) + 1e-300)
        # One inductance converts all rows to flux, since all rows have the same current noise.
        normal = -n * values["L_q"]
        residual = (current_error * normal.conj()).real
        # The flux acts on the current component along n by n' I'.
        current_slope = n.real * dd + n.imag * dq + 1j * (n.real * dq + n.imag * qq)
        to_flux = direction * current_slope * values["L_q"]

        def project(change: NDArray[np.complexfloating]) -> Array:
            return -(change * normal.conj()).real

        d, q = psi.real, psi.imag
        absolute_d, absolute_q = np.abs(d), np.abs(q)
        S, T, U, V = model.S, model.T, model.U, model.V
        psi_f = model.psi_f
        cross = absolute_d**U * absolute_q ** (V + 2) * d / (V + 2) + 1j * absolute_d ** (
            U + 2
        ) * absolute_q**V * q / (U + 2)
        by_name = {
            "a_d0": project(d - psi_f + 0j),
            "a_dd": project(absolute_d**S * d - psi_f ** (S + 1) + 0j),
            "a_q0": project(1j * q),
            "a_qq": project(1j * absolute_q**T * q),
            "a_dq": project(cross),
            "psi_f": project(-(model.a_d0 + (S + 1) * model.a_dd * psi_f**S) * np.ones_like(psi)),
        }
        return Linearisation(residual, to_flux, by_name, current * direction.conj())


@dataclass(frozen=True)
class Cage:
    """Cage rotor: ``|x| - ψ`` with ``dψ/dt = R_R (i_d - ψ/L_M)`` (docs/theory.md, section 15).

    ψ starts at |x| of the first row.
    """

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
            above, below = (
                self._rotor_flux(
                    i.real, first, **{"R_R": R_R, "L_M": L_M, name: values[name] * factor}
                )
                for factor in (1 + STEP, 1 - STEP)
            )
            by_name[name] = -(above - below) / (2 * STEP * values[name])
        decay = np.exp(-R_R / L_M * self.sample_time * np.arange(len(x)))
        by_name["L_s"] = -i.real + decay * i.real[0]
        residual = length - self._rotor_flux(i.real, first, R_R, L_M)
        return Linearisation(residual, direction, by_name, i, -decay * direction[0])

    def _rotor_flux(self, i_d: Array, first: float, R_R: float, L_M: float) -> Array:
        """Integrate the rotor flux from its first value; i_d is linear between the rows."""
        from scipy.signal import lfilter  # the import is slow; only a cage needs it

        decay = float(np.exp(-R_R / L_M * self.sample_time))
        excitation = np.concatenate([[first], (1 - decay) * L_M * (i_d[1:] + i_d[:-1]) / 2])
        return np.asarray(lfilter([1.0], [1.0, -decay], excitation))
