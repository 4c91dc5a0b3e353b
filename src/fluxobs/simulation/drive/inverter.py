"""Two-level inverter, which turns a commanded voltage into the actual voltage."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from ...errors import ModelError
from ..precision import not_negative, positive
from .vectors import from_phases, phases


class Inverter(eqx.Module):
    """An inverter that is averaged over a switching period or switches by carrier comparison.

    Each sample is one switching period with centred pulses, so sampled currents have no ripple.
    Every turn-on is delayed by `dead_time`. A leg's pulse is shorter by this time if its current
    flows out, and longer if its current flows in. The voltage drop of the devices, `drop` + `R_on`
    |i|, opposes the current.

    Parameters
    ----------
    dead_time : float
        Dead time [s], >= 0.
    drop, R_on : float
        Forward voltage [V] and resistance [Ω] of a switch or diode, >= 0.
    smoothing : float
        Size of the current ripple [A], > 0, over which the averaged inverter smooths the sign.
    switching : int
        Integration intervals per sample of the switching inverter; 0 for the averaged inverter.
    """

    dead_time: Array
    drop: Array
    R_on: Array
    smoothing: Array
    switching: int = eqx.field(static=True)

    def __init__(
        self,
        dead_time: Any = 0.0,
        drop: Any = 0.0,
        R_on: Any = 0.0,
        smoothing: Any = 0.1,
        switching: int = 0,
    ) -> None:
        self.dead_time, self.drop = not_negative("dead_time", dead_time), not_negative("drop", drop)
        self.R_on, self.smoothing = not_negative("R_on", R_on), positive("smoothing", smoothing)
        if not isinstance(switching, int) or isinstance(switching, bool) or switching < 0:
            raise ModelError(
                f"switching must be a number of intervals, or 0 to average, got {switching!r}"
            )
        self.switching = switching

    def duties(self, voltage: Array, dc_link: Array) -> Array:
        """Return duty cycles (3,) in [0, 1] for a voltage vector, with a centred zero sequence."""
        share = phases(voltage) / dc_link
        centre = (jnp.max(share) + jnp.min(share)) / 2
        return jnp.clip(0.5 + share - centre, 0.0, 1.0)

    def averaged(self, duties: Array, dc_link: Array, current: Array, period: Array) -> Array:
        """Return the mean voltage over the period [V]."""
        i = phases(current)
        lost = self.dead_time / period * dc_link + self.drop
        legs = duties * dc_link - lost * jnp.tanh(i / self.smoothing) - self.R_on * i
        return from_phases(legs)

    def switched(
        self, duties: Array, dc_link: Array, current: Array, period: Array, part: Array
    ) -> Array:
        """Return the mean voltage [V] over interval `part`, with exact switching edges."""
        i = phases(current)
        outwards = i > 0
        # Dead time delays the upper switch if the current flows out, else the lower switch.
        on = (1 - duties) / 2 + jnp.where(outwards, self.dead_time / period, 0.0)
        off = (1 + duties) / 2 + jnp.where(outwards, 0.0, self.dead_time / period)
        # A leg that stays on one side has no edges.
        on = jnp.where(duties >= 1, 0.0, on)
        off = jnp.where(duties >= 1, 1.0, jnp.where(duties <= 0, on, off))
        start, stop = part / self.switching, (part + 1) / self.switching
        high = jnp.clip(jnp.minimum(off, stop) - jnp.maximum(on, start), 0.0, None) * self.switching
        legs = high * dc_link - self.drop * jnp.sign(i) - self.R_on * i
        return from_phases(legs)
