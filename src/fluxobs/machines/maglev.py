"""Two opposed coils that hold a lever: Knospe's magnetic-levitation benchmark."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..constraint import QuadraticConstraint
from ..validation import Positive
from .base import Machine

Array = NDArray[np.float64]


class MagLev2DOF(Machine):
    """Opposed coils, ``i₁ = φ₁(g - q)/k₁``, ``i₂ = φ₂(g + q)/k₂``: ``2gφ₁φ₂ = k₁i₁φ₂ + k₂i₂φ₁``.

    The flux is that of a core, φ, with ``N φ̇ = u - R i``. Only k, g, R and N enter the observer.

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
        [A]; sets the scale of what is plausible.

    References
    ----------
    C. R. Knospe, "The nonlinear control benchmark experiment", American Control Conference, 2000.
    """

    kind = "maglev-2dof"
    frame = "ports"
    memory = 0.15  # mechanics are slower than a rotor

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
        """``R/N`` on the diagonal: the state is the flux of a core, not its linkage."""
        return np.asarray(self.resistance / self.N * np.eye(2))

    @property
    def B(self) -> Array:
        return np.eye(2) / self.N

    @property
    def constraint(self) -> QuadraticConstraint:
        swap = np.array([[0.0, 1.0], [1.0, 0.0]])
        mixed = -np.array([[0.0, self.k_2], [self.k_1, 0.0]])
        return QuadraticConstraint(self.g * swap, mixed, np.zeros((2, 2)))

    def flux_base(self, psi_f: float | None, rated_current: float) -> float | None:
        return float(np.sqrt(self.k_1 * self.k_2)) * rated_current / self.g

    def constraint_noise(self, flux_base: float, rated_current: float, noise: float) -> float:
        return float(np.hypot(self.k_1, self.k_2)) * flux_base * noise

    def position(self, flux: Array, current: Array) -> tuple[Array, Array]:
        """Displacement q [m] and the length of the flux vector that says it [Wb].

        Both coils say ``φ_k q``; least squares weighs them. Undefined as the flux vanishes.

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
        said = phi_1 * (self.g * phi_1 - self.k_1 * i_1) + phi_2 * (self.k_2 * i_2 - self.g * phi_2)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(said / square), np.asarray(np.sqrt(square))
