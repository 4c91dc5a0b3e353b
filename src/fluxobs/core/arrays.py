"""The type of floating-point arrays, and runs of true values."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def runs(mask: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return first index and end of each run of true values; shape (runs, 2)."""
    edges = np.diff(np.concatenate([[0], mask.astype(int), [0]]))
    return np.flatnonzero(edges).reshape(-1, 2)
