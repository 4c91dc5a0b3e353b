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
#: Rows of a mean. A gain above this multiple of its spread, over √chunks, is no chance.
CHUNK, CHANCE = 256, 4.0
#: Second differences with this multiple of the noise's variance are no noise.
LARGER = 2.0
#: Sum of the squares of (1, -2, 1).
SQUARES = 6.0


def _is_noise(differences: Array, noise: float) -> bool:
    """Whether second differences of currents are no larger than their noise makes them.

    With an injected signal or block commutation they are the response to the voltage.
    """
    count = max(1, len(differences) // CHUNK)
    rows = len(differences) // count * count
    squares = (differences[:rows] ** 2).reshape(count, -1, 2).mean(axis=1)
    return bool((np.median(squares, axis=0) < LARGER * SQUARES * noise**2).all())


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
    known = np.asarray(np.isfinite(u).all(axis=1))
    u = np.where(known[:, None], u, 0.0)
    # White noise is what neighbouring rows do not explain: second differences.
    u, i = u[2:] - 2 * u[1:-1] + u[:-2], i[2:] - 2 * i[1:-1] + i[:-2]
    whole = known[2:] & known[1:-1] & known[:-2]
    u, i = np.where(whole[:, None], u, 0.0), np.where(whole[:, None], i, 0.0)
    best, found = np.zeros(2), 0
    if not _is_noise(i, noise):
        return best, found
    for delay in DELAYS:
        if len(u) <= delay:
            break
        # Steps of the drive are no noise, but few: the median of many means ignores them.
        product = u[delay:] * i[:-delay]
        count = max(1, len(product) // CHUNK)
        means = product[: len(product) // count * count].reshape(count, -1, 2).mean(axis=1)
        gain = np.median(means, axis=0) / SQUARES / noise**2
        spread = np.median(np.abs(means / SQUARES / noise**2 - gain), axis=0)
        gain = np.where(gain < -CHANCE * spread / np.sqrt(count), gain, 0.0)
        if gain.sum() < best.sum():
            best, found = gain, delay
    return best, found
