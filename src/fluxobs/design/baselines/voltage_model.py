"""Integration of the voltage with a forgetting that is undone at the present speed."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from .base import Array, Baseline, Guess, PllState, angle, number, pll, pll_start


class VoltageModelState(NamedTuple):
    first: Array
    second: Array
    pll: PllState


class FilteredVoltageModel(Baseline):
    """Low-pass instead of an integrator, ``λ_c' = y - ω_c λ_c`` (order 1), or that and a high-pass
    after it (order 2), which blocks offsets; what either takes at the present speed is given back,
    ``λ̂ = λ_c (1 - jω_c/ω̂)^order``.

    Parameters
    ----------
    cutoff : float
        ω_c [rad/s].
    bandwidth : float
        Of the phase-locked loop that says ω̂ [rad/s].

    References
    ----------
    J. Hu, B. Wu, "New integration algorithms for estimating motor flux over a wide speed range",
    IEEE Trans. Power Electronics 13 (1998), doi:10.1109/63.712323.
    """

    cutoff: Array
    bandwidth: Array
    order: int = eqx.field(static=True)

    def __init__(
        self, motor: Any, sample_time: Any, cutoff: Any, bandwidth: Any, order: int = 1
    ) -> None:
        self.motor, self.sample_time = motor, number(sample_time)
        self.cutoff, self.bandwidth, self.order = number(cutoff), number(bandwidth), order

    def start(self) -> VoltageModelState:
        flux = jax.lax.complex(self.size(), jnp.zeros(()))
        return VoltageModelState(flux, 0 * flux, pll_start())

    def advance(
        self,
        own: VoltageModelState,
        voltage: Array,
        volt_seconds: Array,
        current: Array,
        before: Array,
    ) -> tuple[VoltageModelState, Guess]:
        h = self.sample_time
        # Bilinear, so that the compensation is right up to (ωh)².
        a = self.cutoff * h / 2
        first = ((1 - a) * own.first + volt_seconds) / (1 + a)
        second = ((1 - a) * own.second + first - own.first) / (1 + a)
        speed = own.pll.speed
        least = self.cutoff
        safe = jnp.where(jnp.abs(speed) > least, speed, jnp.where(speed < 0, -least, least))
        give_back = jax.lax.complex(jnp.ones(()), -self.cutoff / safe)
        flux = first * give_back if self.order == 1 else second * give_back**2
        theta = angle(self.active(flux, current))
        loop = pll(own.pll, theta, self.bandwidth, h)
        return VoltageModelState(first, second, loop), Guess(theta, loop.speed, flux)
