"""Permanent-magnet synchronous machines with one effective inductance."""

from __future__ import annotations

import numpy as np

from ..constraint import QuadraticConstraint
from ..validation import Positive
from .base import RotatingMachine


class MagnetMachine(RotatingMachine):
    """A machine whose position vector λ - L i has the constant length of the magnet flux.

    The relation is ``|λ - L i|² = ψ²``: Q1 = I, Q2 = -2L I, Q3 = L² I, d = -ψ².
    """

    psi_f: Positive | None = None

    @property
    def constraint(self) -> QuadraticConstraint:
        L, one = self.position_inductance, np.eye(2)
        return QuadraticConstraint(one, -2 * L * one, L * L * one, d=-((self.psi_f or 0.0) ** 2))

    def flux_base(self, psi_f: float | None, rated_current: float) -> float | None:
        return psi_f

    def constraint_noise(self, flux_base: float, rated_current: float, noise: float) -> float:
        return 2 * self.position_inductance * flux_base * noise


class SurfacePMSM(MagnetMachine):
    """Surface permanent-magnet synchronous machine, ``λ = L_s i + ψ_f e(θ_e)``.

    Parameters
    ----------
    R_s, n_p, rated_current
        See :class:`RotatingMachine`.
    L_s : float
        Phase inductance (synchronous, per phase in star) [H], > 0.
    psi_f : float, optional
        Peak phase flux linkage of the magnets [Wb]. A scale only: the estimates do not use it,
        the observer returns its own.

    Examples
    --------
    >>> machine = SurfacePMSM(R_s=0.39, L_s=1.4e-3, n_p=8, psi_f=0.032)
    >>> machine.constraint.invisible_offsets().shape  # a current bias hides in the flux
    (4, 2)
    """

    kind = "surface-pmsm"

    L_s: Positive

    @property
    def position_inductance(self) -> float:
        return self.L_s
