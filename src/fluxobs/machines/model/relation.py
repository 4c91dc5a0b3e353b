"""The relation of a machine with constant inductances, linearised: |x| - ψ - (L_d - L_q) i_d = 0.

The position vector is x = λ - L_q i; i_d is the current along x (docs/theory.md, section 13).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...core.arrays import Array

Complex = NDArray[np.complex128]


class LinearRelation(NamedTuple):
    """Length of the position vector, its part from the current, and their derivatives.

    A change dλ of the flux changes `length` - `from_current` by Re(conj(by_flux) dλ).
    """

    x: Complex  # position vector [Wb]
    length: Array  # [Wb]
    direction: Complex  # x / length
    i_d: Array  # [A]
    from_current: Array  # (L_d - L_q) i_d [Wb]
    by_flux: Complex
    by_L_d: Array  # [A]
    by_L_q: Array  # [A]


def linearise(flux: Complex, current: Complex, L_d: float, L_q: float) -> LinearRelation:
    """Return the relation at each flux [Wb] and current [A] in αβ; inductances in [H]."""
    x = flux - L_q * current
    length = np.abs(x) + 1e-300
    direction = x / length
    i_d = (direction.conj() * current).real
    saliency = L_d - L_q
    by_flux = direction - saliency * (current - i_d * direction) / length
    by_L_q = i_d - (by_flux.conj() * current).real
    return LinearRelation(x, length, direction, i_d, saliency * i_d, by_flux, -i_d, by_L_q)
