"""Interior permanent-magnet synchronous machine, through its active flux."""

from __future__ import annotations

from ..validation import Positive
from .surface_pmsm import MagnetMachine


class InteriorPMSM(MagnetMachine):
    """Interior PMSM: its active flux ``λ - L_q i`` has the length ``ψ_f + (L_d - L_q) i_d``.

    That length is taken as constant, as if the machine were a surface PMSM with L = L_q. This
    holds while i_d is small or varies slowly against the memory; with i_d moving quickly the
    estimate is disturbed for about a memory after each change, and what is returned as magnet
    flux is the active flux.

    Parameters
    ----------
    R_s, n_p, rated_current
        See :class:`RotatingMachine`.
    L_d, L_q : float
        Inductances along and across the magnet axis [H], > 0.
    psi_f : float, optional
        Peak phase flux linkage of the magnets [Wb]; a scale only.
    """

    kind = "interior-pmsm"

    L_d: Positive
    L_q: Positive

    @property
    def saliency(self) -> float:
        return self.L_d - self.L_q

    @property
    def position_inductance(self) -> float:
        return self.L_q
