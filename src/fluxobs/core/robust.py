"""Huber's weights and loss for robust least squares.

Huber, Robust estimation of a location parameter, 1964, doi:10.1214/aoms/1177703732.
"""

from __future__ import annotations

import numpy as np

from .arrays import Array

#: Residuals above this many standard deviations count linearly. This keeps 95 % of the efficiency
#: of least squares under normal noise.
HUBER = 1.345


def huber_weight(residual: Array, scale: float) -> Array:
    """Return the weights, 0 to 1, of squared residuals whose standard deviation is `scale`."""
    return np.asarray(np.minimum(1.0, HUBER * scale / (np.abs(residual) + 1e-300)))


def huber_loss(residual: Array, scale: float) -> Array:
    """Return the loss of residuals; within HUBER standard deviations it is half their square."""
    r = np.abs(residual) / scale
    return np.asarray(np.where(r < HUBER, r**2 / 2, HUBER * r - HUBER**2 / 2))
