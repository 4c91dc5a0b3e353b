"""Surface permanent-magnet synchronous machine."""

from __future__ import annotations

from ..core.validation import NotNegative, Positive
from .rotating import MagnetMachine


class SurfacePMSM(MagnetMachine):
    """Surface permanent-magnet synchronous machine, ``λ = L_s i + ψ_f e(θ_e)``.

    Parameters
    ----------
    R_s, n_p, rated_current
        See :class:`RotatingMachine`.
    L_s : float
        Phase inductance (synchronous, per phase in star) [H], > 0.
    L_s_rated : float, optional
        Apparent inductance at the rated current [H], if it falls with the current.
    psi_f : float, optional
        Peak phase flux linkage of the magnets [Wb]. Only a scale: no estimate depends on psi_f, and
        the observer returns its own estimate of the flux.
    flux_map
        See :class:`SynchronousMachine`.

    Examples
    --------
    >>> machine = SurfacePMSM(R_s=0.39, L_s=1.4e-3, n_p=8, psi_f=0.032)
    >>> machine.constraint.invisible_offsets().shape  # a current bias hides in the flux
    (4, 2)
    """

    kind = "surface-pmsm"
    inductances = ("L_s", "L_s")

    L_s: Positive
    L_s_std: NotNegative | None = None
    L_s_rated: Positive | None = None
