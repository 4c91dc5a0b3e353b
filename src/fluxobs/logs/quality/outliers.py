"""Currents of one or two rows that contradict their neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...core.arrays import Array

#: An outlier is off the middle of its neighbours by this share of the usual current.
OUTLIER_SHARE = 0.25
#: Its neighbours differ by less than this share of its deviation: at a step, and beside an outlier,
#: they differ by twice the deviation.
AGREEMENT = 0.7
#: Most consecutive outliers.
LONGEST = 2
#: Largest share of outliers.
MOST = 0.1


def outliers(current: Array, usual: float) -> NDArray[np.bool_]:
    """Return which rows are outliers.

    Parameters
    ----------
    current : (rows, 2) ndarray
        [A].
    usual : float
        Usual size of the current [A].
    """
    found = np.zeros(len(current), bool)
    if len(current) < 3:
        return found
    with np.errstate(over="ignore", invalid="ignore"):
        for rows in range(1, LONGEST + 1):
            count = len(current) - rows - 1
            if count < 1:
                break
            before, after = current[:count], current[rows + 1 :]
            apart = _size(after - before)
            sizes = [
                _size(current[n : n + count] - before - n / (rows + 1) * (after - before))
                for n in range(1, rows + 1)
            ]
            least = sizes[0]
            for size in sizes[1:]:
                least = np.minimum(least, size)
            wrong = (least > OUTLIER_SHARE * usual) & (apart < AGREEMENT * least)
            for n in range(1, rows + 1):
                found[n : n + count] |= wrong
    # An injected signal alternates: then most rows differ from their neighbours.
    return found if found.mean() < MOST else np.zeros(len(current), bool)


def _size(vectors: Array) -> Array:
    return np.asarray(np.hypot(vectors[:, 0], vectors[:, 1]))
