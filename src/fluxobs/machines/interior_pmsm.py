"""Interior permanent-magnet synchronous machine, described by its active flux."""

from __future__ import annotations

from ..core.validation import NotNegative, Positive
from .rotating import MagnetMachine


class InteriorPMSM(MagnetMachine):
    """Interior PMSM, whose active flux ``λ - L_q i`` has the length ``ψ_f + (L_d - L_q) i_d``.

    The observers account for i_d by the machine's flux map. A current bias δ_i falsifies i_d and
    turns the position by up to (L_q - L_d) δ_i / ψ_f. The plain observer returns the active flux as
    psi_f.

    Parameters
    ----------
    R_s, n_p, rated_current
        See :class:`RotatingMachine`.
    L_d, L_q : float
        Inductances along and across the magnet axis [H], > 0.
    L_d_rated, L_q_rated : float, optional
        Apparent inductances at the rated current [H], if they fall with the current.
    psi_f : float, optional
        Peak phase flux linkage of the magnets [Wb]; only a scale if i_d is constant.
    flux_map
        See :class:`SynchronousMachine`.
    """

    kind = "interior-pmsm"
    inductances = ("L_d", "L_q")
    length_name = "Active flux psi_f + (L_d - L_q) i_d"

    L_d: Positive
    L_q: Positive
    L_d_std: NotNegative | None = None
    L_q_std: NotNegative | None = None
    L_d_rated: Positive | None = None
    L_q_rated: Positive | None = None
