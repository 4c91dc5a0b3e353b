"""Fixed-interval smoother of a log's slow errors, for many right-hand sides at once.

Between two blocks of samples the flux changes by the volt-seconds, which are known, and by a
correction c, which integrates a drift θ and a white voltage error. The states are c [Wb] and θ [V],
two components each, and the deviations of the magnet flux [Wb] and of the resistance [Ω] from their
assumed values.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .. import _smoother
from ..core.arrays import Array
from ..errors import ModelError

#: Numbers of states, and of measurements of a block at most.
STATES: int = _smoother.states
MEASUREMENTS: int = _smoother.measurements


@dataclass(frozen=True, eq=False)
class Blocks:
    """Blocks of samples, each with `measurements` measurements, at most MEASUREMENTS.

    Parameters
    ----------
    duration : (blocks,) ndarray
        Time since the previous block [s]; the first is not used.
    coupling : (blocks, 2) ndarray
        Change of the flux since the previous block per unit of resistance [A s]: -∫ i dt.
    decay : (blocks,) ndarray
        Factor on the deviation of the magnet flux since the previous block, 0 to 1.
    walk : (blocks, 4) ndarray
        Variance gained since the previous block by a component of the flux, a component of the
        drift, the magnet flux, and the resistance; >= 0.
    row : (blocks, measurements, 6) ndarray
        Measurements as linear functions of the state.
    variance : (blocks, measurements) ndarray
        Variance of a measurement, > 0; infinite without it. Errors of measurements are independent.
    """

    duration: Array
    coupling: Array
    decay: Array
    walk: Array
    row: Array
    variance: Array

    def table(self) -> Array:
        """Return the blocks as rows of numbers, in the order of fo_smooth_block.

        Raises
        ------
        ModelError
            A variance is not positive, or a number is missing.
        """
        blocks, count = self.variance.shape
        columns = (
            self.duration[:, None],
            self.coupling,
            self.decay[:, None],
            self.walk,
            np.zeros((blocks, 3)),
            self.row.reshape(blocks, -1),
            np.zeros((blocks, (MEASUREMENTS - count) * STATES)),
        )
        known = np.concatenate(columns, axis=1)
        missing = np.full((blocks, MEASUREMENTS - count), np.inf)
        table = np.concatenate([known, self.variance, missing], axis=1)
        if not (np.isfinite(known).all() and (self.variance > 0).all()):
            raise ModelError("the smoother needs finite blocks and positive variances")
        return np.ascontiguousarray(table, float)


class Smoothed(NamedTuple):
    """Smoothed blocks.

    Attributes
    ----------
    state : (blocks, 6, sides) ndarray
        State for each right-hand side, given all measurements.
    covariance : (blocks, 6, 6) ndarray
        Covariance of the state, equal for all right-hand sides.
    innovation : (blocks, measurements, sides) ndarray
        Measurement less its prediction from earlier ones; 0 without measurement.
    variance : (blocks, measurements) ndarray
        Variance of the innovation; infinite without measurement.
    """

    state: Array
    covariance: Array
    innovation: Array
    variance: Array


def smooth(blocks: Blocks, measured: Array, start: Array) -> Smoothed:
    """Return the smoothed states of all blocks.

    The gains do not depend on the measurements. If the first column of `measured` is a measurement
    and the others are its derivatives by parameters, then the smoothed columns are the state and
    its derivatives by the parameters, and so are the innovations.

    Parameters
    ----------
    blocks : Blocks
    measured : (blocks, measurements, sides) ndarray
        Measurements of each right-hand side.
    start : (6,) ndarray
        Variance of each state in the first block before its measurement; the mean is zero.

    Raises
    ------
    ModelError
        Shapes do not agree, or a number is missing or impossible.

    References
    ----------
    Bierman, Fixed interval smoothing with discrete measurements, 1973,
    doi:10.1080/00207177308932487. Friedland, Treatment of bias in recursive filtering, 1969,
    doi:10.1109/TAC.1969.1099223.
    """
    table = blocks.table()
    shape = blocks.variance.shape
    if measured.ndim != 3 or measured.shape[:2] != shape or np.shape(start) != (STATES,):
        raise ModelError(
            f"the smoother needs measurements of shape {shape} for each right-hand side and "
            f"{STATES} variances, got {measured.shape} and {np.shape(start)}"
        )
    sides = np.ascontiguousarray(measured, float)
    if not np.isfinite(sides[np.isfinite(blocks.variance)]).all():
        raise ModelError("a measurement of the smoother is not finite")
    return Smoothed(*_smoother.smooth(table, sides, np.ascontiguousarray(start, float)))
