"""Sensors with bias, noise and quantisation, which turn a true signal into a measured signal."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from ...core.arrays import Array
from ...errors import ModelError


@dataclass(frozen=True, eq=False)
class Steps:
    """A piecewise constant signal: ``values[0]`` at first, ``values[k + 1]`` from ``times[k]`` on.

    Parameters
    ----------
    values : (k + 1, n) array_like
    times : (k,) array_like
        Increasing times [s]; empty for a constant signal.

    Examples
    --------
    >>> Steps([[0.0], [1.0]], [50.0]).at([49.9, 50.0])[:, 0].tolist()
    [0.0, 1.0]
    """

    values: Array
    times: Array = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        values = np.array(self.values, dtype=float)
        times = np.array(self.times, dtype=float)
        if values.ndim != 2 or times.ndim != 1 or len(values) != len(times) + 1:
            raise ModelError(
                f"values must have shape (len(times) + 1, n), got {values.shape} and {times.shape}"
            )
        if (np.diff(times) <= 0).any():
            raise ModelError(f"times must increase, got {times.tolist()}")
        for name, array in (("values", values), ("times", times)):
            if not np.isfinite(array).all():
                raise ModelError(f"{name} must be finite, got {array.tolist()}")
            object.__setattr__(self, name, array)

    def at(self, t: ArrayLike) -> Array:
        """Return the values (…, n) at the times t (…)."""
        return np.asarray(self.values[np.searchsorted(self.times, np.asarray(t), side="right")])


@dataclass(frozen=True, eq=False)
class Sensor:
    """One measured vector: ``quantise(true + bias(t) + noise)``.

    Parameters
    ----------
    bias : Steps
        Bias in the unit of the signal.
    noise : float
        Standard deviation of white noise, >= 0.
    quantum : float
        Step of the converter, >= 0; 0 means no quantisation.
    """

    bias: Steps
    noise: float = 0.0
    quantum: float = 0.0

    def __post_init__(self) -> None:
        for name in ("noise", "quantum"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise ModelError(f"{name} must be a number >= 0, got {value}")

    def measure(self, t: ArrayLike, true: ArrayLike, seed: int) -> Array:
        """Return the measured signal (rows, n); a seed always gives the same signal."""
        signal = np.asarray(true, float)
        measured = signal + self.bias.at(t)
        if self.noise > 0:
            rng = np.random.default_rng(seed)
            measured = measured + self.noise * rng.standard_normal(signal.shape)
        if self.quantum > 0:
            measured = self.quantum * np.round(measured / self.quantum)
        return np.asarray(measured)
