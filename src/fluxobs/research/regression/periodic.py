"""The regression of a periodic trajectory in steady state, exact to rounding.

The filters of Lemma 1 are a cascade of lags driven by products of signals. In the periodic steady
state, every lag is a division in the frequency domain, which needs no time step and has no
transient. Between the samples, the regression is the trigonometric interpolant.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...core.arrays import Array
from ...errors import ModelError
from ...machines.model.constraint import QuadraticConstraint
from .filtered import FilteredRegression, cascade, read_out_record
from .regressors import Regressors

#: Largest share of a signal's power in the highest tenth of its harmonics.
RESOLVED = 1e-12


class Orbit(NamedTuple):
    """One period of the observer's measurements in uniform samples; the last is at period - h.

    Attributes
    ----------
    period : float
        [s].
    y_m : (samples, n) ndarray
        ``-R i_m + B u_m`` [V].
    current : (samples, n) ndarray
        Measured current [A].
    """

    period: float
    y_m: Array
    current: Array


def periodic_regression(constraint: QuadraticConstraint, corner: float, orbit: Orbit) -> Regressors:
    """Return the corrected regression of Lemma 1 in steady state at the samples of one period.

    Parameters
    ----------
    constraint : QuadraticConstraint
    corner : float
        ν of the filters [rad/s].
    orbit : Orbit

    Raises
    ------
    ModelError
        If the samples are too few to resolve a signal.
    """
    y_m, i = np.asarray(orbit.y_m, float), np.asarray(orbit.current, float)
    regression = FilteredRegression(constraint, corner)
    omega = 2 * np.pi * np.fft.rfftfreq(len(i), orbit.period / len(i))

    def lag(signal: Array) -> Array:
        """Return x of ``x' = -ν x + signal``."""
        spectrum = np.fft.rfft(signal, axis=0)
        filtered = (spectrum.T / (1j * omega + corner)).T
        return np.asarray(np.fft.irfft(filtered, len(i), axis=0))

    for name, signal in (("y_m", y_m), ("current", i)):
        power = np.abs(np.fft.rfft(signal, axis=0)) ** 2
        high = power[-max(1, len(power) // 10) :].sum(axis=0)
        if (high > RESOLVED * power.sum(axis=0)).any():
            raise ModelError(
                f"{name}: {len(i)} samples per period do not resolve this signal; use more samples "
                f"and check that the period is {orbit.period:g} s"
            )
    filters = cascade(regression, lag, y_m, i)
    return read_out_record(regression, filters, i)


def between(signal: ArrayLike, count: int, shift: float) -> Array:
    """Return the trigonometric interpolant of one period at `count` uniform points.

    Parameters
    ----------
    signal : (samples, ...) array_like
    count : int
        Number of points per period, at least `samples`.
    shift : float
        Position of the first point, in steps of period/count.
    """
    samples = np.asarray(signal, float)
    spectrum = np.fft.rfft(samples, axis=0)
    if len(samples) % 2 == 0:
        spectrum[-1] /= 2 if count > len(samples) else 1
    harmonics = np.arange(len(spectrum))
    shifted = (spectrum.T * np.exp(2j * np.pi * harmonics * shift / count)).T
    return np.asarray(np.fft.irfft(shifted, count, axis=0) * (count / len(samples)))
