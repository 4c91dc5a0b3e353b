"""Interior permanent-magnet synchronous machine, through its active flux."""

from __future__ import annotations

from ..validation import NotNegative, Positive
from .rotating import MagnetMachine


class InteriorPMSM(MagnetMachine):
    """Interior PMSM: its active flux ``λ - L_q i`` has the length ``ψ_f + (L_d - L_q) i_d``.

    The plain observer takes that length as constant, as if the machine were a surface PMSM with
    L = L_q. This holds while i_d is small or varies slowly compared with the memory. A quick change
    of i_d disturbs the estimate for about one memory. The psi_f returned is the active flux.

    Parameters
    ----------
    R_s, n_p, rated_current
        See :class:`RotatingMachine`.
    L_d, L_q : float
        Inductances along and across the magnet axis [H], > 0.
    psi_f : float, optional
        Peak phase flux linkage of the magnets [Wb]; only a scale.
    """

    kind = "interior-pmsm"
    inductances = ("L_d", "L_q")
    length_name = "Active flux psi_f + (L_d - L_q) i_d"

    L_d: Positive
    L_q: Positive
    L_d_std: NotNegative | None = None
    L_q_std: NotNegative | None = None
