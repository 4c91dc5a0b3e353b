"""Two opposed coils that hold a lever: Knospe's magnetic-levitation benchmark."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from ..core.arrays import Array
from ..core.validation import Positive
from .contract import Machine, Position
from .model.constraint import QuadraticConstraint


class MagLev2DOF(Machine):
    """Opposed coils: ``k₁i₁ = φ₁(g - q)``, ``k₂i₂ = φ₂(g + q)``, so ``2gφ₁φ₂ = k₁i₁φ₂ + k₂i₂φ₁``.

    The flux is the core flux φ, with ``N φ̇ = u - R i``. The observer uses only k, g, R and N.

    Parameters
    ----------
    k_1, k_2 : float
        Gap times flux per current [m Wb/A].
    g : float
        Gap in the middle position [m].
    R : float
        Resistance of a coil [Ω].
    N : float
        Turns of a coil.
    D : float
        Distance from pivot to magnet [m].
    J : float
        Moment of inertia [kg m²].
    c_1, c_2 : float
        Force constants, F = c φ²/(2k).
    rated_current : float, optional
        Scale of plausible currents [A].

    References
    ----------
    C. R. Knospe, "The nonlinear control benchmark experiment", American Control Conference, 2000.
    """

    kind = "maglev-2dof"
    frame = "ports"
    ports = ("1", "2")
    position_output = Position("position", ("position",), 1e6, " µm", "Position")
    memory = 0.15  # [s]; the lever moves more slowly than a rotor
    measured_voltage = True

    k_1: Positive
    k_2: Positive
    g: Positive
    resistance: Positive = Field(alias="R")
    N: Positive
    D: Positive
    J: Positive
    c_1: Positive
    c_2: Positive

    @property
    def R(self) -> Array:
        """Matrix with ``R/N`` on the diagonal: the state is core flux, not flux linkage."""
        return np.asarray(self.resistance / self.N * np.eye(2))

    @property
    def B(self) -> Array:
        return np.eye(2) / self.N

    @property
    def constraint(self) -> QuadraticConstraint:
        swap = np.array([[0.0, 1.0], [1.0, 0.0]])
        mixed = -np.array([[0.0, self.k_2], [self.k_1, 0.0]])
        return QuadraticConstraint(self.g * swap, mixed, np.zeros((2, 2)))

    def flux_base(self, rated_current: float, psi_f: float | None = None) -> float | None:
        return float(np.sqrt(self.k_1 * self.k_2)) * rated_current / self.g

    def constraint_noise(self, flux_base: float, noise: float) -> float:
        return float(np.hypot(self.k_1, self.k_2)) * flux_base * noise

    def position(self, flux: ArrayLike, current: ArrayLike) -> tuple[Array, Array]:
        """Return the displacement q [m] and the length of the flux vector [Wb].

        Each coil gives an equation for ``φ_k q``; least squares combines both.
        Without flux, q is undefined.

        Parameters
        ----------
        flux, current : (..., 2) array_like

        Returns
        -------
        position, length : (...) ndarray
        """
        phi_1, phi_2 = np.moveaxis(np.asarray(flux, float), -1, 0)
        i_1, i_2 = np.moveaxis(np.asarray(current, float), -1, 0)
        square = phi_1**2 + phi_2**2
        weighted = phi_1 * (self.g * phi_1 - self.k_1 * i_1) + phi_2 * (
            self.k_2 * i_2 - self.g * phi_2
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(weighted / square), np.asarray(np.sqrt(square))

    def position_std(self, flux: Array, flux_std: Array, current: Array) -> Array:
        position, length = self.position(flux, current)
        gaps = np.stack([self.g - position, self.g + position], axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.linalg.norm(flux * gaps * flux_std, axis=-1) / length**2)

    @property
    def position_span(self) -> float:
        return self.g

    def true_position(self, channel: str, value: Array) -> Array:
        return value

    def position_error(self, estimated: Array, true: Array) -> Array:
        return estimated - true
