"""Synchronous reluctance machine."""

from __future__ import annotations

from typing import Self

import numpy as np
from pydantic import model_validator

from .. import _core
from ..core.validation import NotNegative, Positive
from .model.constraint import QuadraticConstraint
from .rotating import SynchronousMachine


class SynchronousReluctance(SynchronousMachine):
    """Synchronous reluctance machine, ``(λ - L_q i)ᵀ(λ - L_d i) = 0``.

    The position vector ``λ - L_q i = (L_d - L_q) i_d e(θ_e)`` lies along d up to half a turn: it
    points backwards if i_d < 0. At i_d = 0 its length is zero, and the position is not valid.

    Parameters
    ----------
    R_s, n_p, rated_current
        See :class:`RotatingMachine`.
    L_d, L_q : float
        Inductances along and across the axis of high permeance [H], L_d > L_q > 0.
    L_d_rated, L_q_rated : float, optional
        Apparent inductances at the rated current [H], if they fall with the current.
    flux_map
        See :class:`SynchronousMachine`.
    """

    kind = "synchronous-reluctance"
    inductances = ("L_d", "L_q")
    half_turn_ambiguous = True
    shortest = _core.usual["SHORTEST_SALIENT"]  # the length depends on i_d
    length_name = "Active flux (L_d - L_q) i_d"

    L_d: Positive
    L_q: Positive
    L_d_std: NotNegative | None = None
    L_q_std: NotNegative | None = None
    L_d_rated: Positive | None = None
    L_q_rated: Positive | None = None

    @model_validator(mode="after")
    def _check_saliency(self) -> Self:
        if not self.L_d > self.L_q:
            raise ValueError(
                f"L_d must be larger than L_q (d is the axis of high permeance), "
                f"got L_d = {self.L_d:g} H, L_q = {self.L_q:g} H"
            )
        return self

    @property
    def constraint(self) -> QuadraticConstraint:
        eye = np.eye(2)
        return QuadraticConstraint(eye, -(self.L_d + self.L_q) * eye, self.L_d * self.L_q * eye)

    def flux_base(self, rated_current: float, psi_f: float | None = None) -> float | None:
        # i_d is about half of the rated current.
        return _core.usual["RELUCTANCE"] * self.L_d * rated_current

    def constraint_noise(self, flux_base: float, noise: float) -> float:
        # |∂w/∂i| = (L_d - L_q) |(L_d i_d, L_q i_q)|, with the flux at its scale.
        return (self.L_d - self.L_q) * flux_base * noise
