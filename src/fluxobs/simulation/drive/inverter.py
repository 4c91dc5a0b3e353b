"""Two-level inverter, which turns a commanded voltage into the actual voltage."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from ...errors import ModelError
from ..precision import not_negative, positive
from .vectors import from_phases, phases

#: Iterations of the implicit current; the test compares with a fine integration.
ITERATIONS = 8


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

    def ideal(self, duties: Array, dc_link: Array) -> Array:
        """Return the mean voltage over the period without losses [V]."""
        return from_phases(duties * dc_link)

    def averaged(self, duties: Array, dc_link: Array, current: Array, period: Array) -> Array:
        """Return the mean voltage over the period at the current in its middle [V]."""
        i = phases(current)
        return from_phases(duties * dc_link - self._resistances(i, dc_link, period) * i)

    def _resistances(self, i: Array, dc_link: Array, period: Array) -> Array:
        """Return the voltage loss of each phase divided by its current `i` [Ω]."""
        lost = self.dead_time / period * dc_link + self.drop
        x = i / self.smoothing
        small = jnp.abs(x) < 1e-3
        chord = jnp.where(small, 1.0, jnp.tanh(x) / jnp.where(small, 1.0, x))
        return lost / self.smoothing * chord + self.R_on

    def middle_current(
        self,
        current: Array,
        lossless: Array,
        by_alpha: Array,
        by_beta: Array,
        dc_link: Array,
        period: Array,
    ) -> Array:
        """Return the current in the middle of a period [A] that starts at `current`.

        Without losses it would be `lossless`; a loss of 1 V along α or β changes it by -`by_alpha`
        or -`by_beta`. The equation is implicit: where the loss moves the current by more than
        `smoothing` within a period, an explicit step would make the current oscillate. Fixed-point
        iteration of the phases' resistances; it converges since they fall with the current.
        """
        alpha, beta = phases(jnp.asarray(1.0 + 0j)), phases(jnp.asarray(1j))
        for _ in range(ITERATIONS):
            r = self._resistances(phases(current), dc_link, period)
            by_real, by_imag = from_phases(r * alpha), from_phases(r * beta)
            a = 1.0 + by_alpha * by_real.real + by_beta * by_real.imag
            b = 1j + by_alpha * by_imag.real + by_beta * by_imag.imag
            determinant = a.real * b.imag - a.imag * b.real
            along = (lossless.real * b.imag - lossless.imag * b.real) / determinant
            across = (a.real * lossless.imag - a.imag * lossless.real) / determinant
            current = jax.lax.complex(along, across)
        return current

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
