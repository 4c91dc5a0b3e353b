"""Items of the error budget, from the shares of the unknowns."""

from __future__ import annotations

import numpy as np

from ..core.arrays import Array
from .posterior import ORDERS, SHARES

#: Order of the harmonic that unequal phases make.
UNEQUAL_PHASES = -2
#: Item → unknowns; what is not listed belongs to the smoother.
ITEM_UNKNOWNS: dict[str, tuple[str, ...]] = {
    "resistance": ("resistance", "heat"),
    "inverter": ("loss", "knee"),
    "lag": ("lag", "delay"),
    "current offsets": ("offset_alpha", "offset_beta"),
    "current gains": ("gain_re", "gain_im", "range"),
    "voltage gains": tuple(f"harmonic_{UNEQUAL_PHASES}_{part}" for part in ("d", "q")),
    "iron loss": ("iron_loss",),
    "L_d": ("L_d", "saturation_d"),
    "L_q": ("L_q", "saturation_q"),
    "magnet flux": ("psi_f",),
    "harmonics": tuple(
        f"harmonic_{order}_{part}"
        for order in ORDERS
        for part in ("d", "q")
        if order != UNEQUAL_PHASES
    ),
    "rotor": ("rotor_resistance", "magnetizing"),
}


def shares_by_item(shares: Array, names: tuple[str, ...], one_inductance: bool) -> Array:
    """Return variances by item from those by unknown; (..., len(SHARES)) → (..., len(names)).

    Correlations count for both unknowns by half, so a share can be negative; such a share counts as
    zero. The item "smoother" takes what belongs to no other one. With one inductance, "L_d" takes
    the share of both axes.
    """
    of = {unknown: item for item, unknowns in ITEM_UNKNOWNS.items() for unknown in unknowns}
    if one_inductance:
        of |= dict.fromkeys(ITEM_UNKNOWNS["L_q"], "L_d")
    columns = [of.get(share, "smoother") for share in SHARES]
    sums = [
        shares[..., [n for n, item in enumerate(columns) if item == name]].sum(axis=-1)
        for name in names
    ]
    return np.asarray(np.maximum(np.stack(sums, axis=-1), 0.0))
