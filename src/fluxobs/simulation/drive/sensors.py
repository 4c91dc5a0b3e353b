"""Sensors of the drive, for three phase currents and the DC link."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from ...errors import ModelError
from ..precision import not_negative, positive, real
from .profile import Profile
from .vectors import from_phases, phases


class Sensors(eqx.Module):
    """Sensors of current and DC link; gains and limits are per phase, offset and noise are in αβ.

    Parameters
    ----------
    offset : Profile, or (2,) array_like
        Offset [A], which is constant, drifts or jumps.
    noise : float
        Standard deviation of an αβ component [A].
    gain : (3,) array_like
        Gains of the phases; 1 is exact.
    quantum : float
        Step of the converter [A]; 0 for no quantisation.
    range : float
        Range of the converter [A], from minus this value to plus this value.
    jitter : float
        Standard deviation of the sampling instant [s].
    dc_link_gain : float
        Measured DC-link voltage divided by the true DC-link voltage.
    lag : float
        Delay of the current sensors [s], well below a sample; the sensors show i - lag di/dt. If
        it is negative, they sample after the row: di/dt is that of the next voltage.
    """

    offset: Profile
    noise: Array
    gain: Array
    quantum: Array
    range: Array
    jitter: Array
    dc_link_gain: Array
    lag: Array

    def __init__(
        self,
        offset: Any = (0.0, 0.0),
        noise: Any = 0.0,
        gain: Any = (1.0, 1.0, 1.0),
        quantum: Any = 0.0,
        range: Any = 1e9,
        jitter: Any = 0.0,
        dc_link_gain: Any = 1.0,
        lag: Any = 0.0,
    ) -> None:
        self.offset = Profile.of(offset)
        if self.offset.values.ndim != 2 or self.offset.values.shape[-1] != 2:
            raise ModelError("offset must be a pair (α, β), or a Profile of pairs")
        self.noise, self.gain = not_negative("noise", noise), positive("gain", gain, (3,))
        self.quantum, self.range = not_negative("quantum", quantum), positive("range", range)
        self.jitter, self.lag = not_negative("jitter", jitter), real("lag", lag)
        self.dc_link_gain = positive("dc_link_gain", dc_link_gain)

    def later(self, late: Array) -> Array:
        """Return how much later than the row the current is sampled [s]; < 0: earlier."""
        return jnp.asarray(self.jitter * late - self.lag)

    def measure(
        self, current: Array, slope: Array, offset: Array, noise: Array, late: Array
    ) -> Array:
        """Return the measured current; `slope` is di/dt, `noise` and `late` are standard normal."""
        sensed = current + self.later(late) * slope + offset + self.noise * noise
        abc = jnp.clip(self.gain * phases(sensed), -self.range, self.range)
        step = jnp.where(self.quantum > 0, self.quantum, 1.0)
        return from_phases(jnp.where(self.quantum > 0, step * jnp.round(abc / step), abc))
