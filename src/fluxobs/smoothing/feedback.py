"""How a drive's current controller returns the noise of the measured currents in its voltages.

The noise of a row is in the voltage of an interval that ends some rows later. It is then in the
measurement of a block and in the regressor of the lag, whose estimate it would bias.
"""

from __future__ import annotations

import numpy as np

from ..core.arrays import Array
from ..machines.model.frames import rotate

#: Rows from a current to the end of the interval with its voltage: at once, a sample late, two.
DELAYS = (1, 2, 3)
#: Least share of the gain's part in the covariance that is no chance: four standard deviations.
CHANCE = 4.0


def feedback(voltage: Array, current: Array, angle: Array, noise: float) -> tuple[Array, int]:
    """Return the gains of the voltage by the noise of i_d and i_q [V/A], and their delay [rows].

    Parameters
    ----------
    voltage, current : (rows, 2) ndarray
        Mean voltage of the interval that ends at the row [V], NaN if unknown; current [A].
    angle : (rows,) ndarray
        Electrical angle of the rotor [rad], roughly.
    noise : float
        Standard deviation of a component of the current [A].

    Returns
    -------
    gains : (2,) ndarray
        Along d and q; zeros without feedback.
    delay : int
        Rows from the current to the end of the interval; 0 without feedback.
    """
    u, i = rotate(voltage, -angle), rotate(current, -angle)
    known = np.isfinite(u).all(axis=1)
    u = np.where(known[:, None], u, 0.0)
    # White noise is what neighbouring rows do not explain: second differences.
    u, i = u[2:] - 2 * u[1:-1] + u[:-2], i[2:] - 2 * i[1:-1] + i[:-2]
    whole = known[2:] & known[1:-1] & known[:-2]
    u, i = np.where(whole[:, None], u, 0.0), np.where(whole[:, None], i, 0.0)
    best, found = np.zeros(2), 0
    for delay in DELAYS:
        if len(u) <= delay:
            break
        # The sum of the squares of (1, -2, 1) is 6.
        product = u[delay:] * i[:-delay]
        gain = product.mean(axis=0) / (6 * noise**2)
        chance = CHANCE * np.sqrt((product**2).mean(axis=0) / len(product)) / (6 * noise**2)
        gain = np.where(gain < -chance, gain, 0.0)
        if gain.sum() < best.sum():
            best, found = gain, delay
    return best, found
