"""Voltage model with a filter instead of the integrator, compensated at the present speed."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from .base import Baseline, Guess, PllState, angle, leaf, pll, pll_start


class VoltageModelState(NamedTuple):
    first: Array
    second: Array
    pll: PllState


class FilteredVoltageModel(Baseline):
    """Low-pass instead of an integrator, ``λ_c' = y - ω_c λ_c`` (order 1), optionally followed by a
    high-pass that blocks offsets (order 2).

    ω_c is proportional to the speed, down to `least`. The gain and phase of the filters at that
    speed are compensated, ``λ̂ = λ_c (1 - jω_c/ω̂)^order``.

    Parameters
    ----------
    cutoff, least : float
        ω_c over |ω̂|; least value of ω_c [rad/s].
    bandwidth : float
        Bandwidth of the phase-locked loop that estimates ω̂ [rad/s].

    References
    ----------
    M. Hinkkanen, J. Luomi, "Modified integrator for voltage model flux estimation of induction
    motors", IEEE Trans. Industrial Electronics 50 (2003).
    """

    cutoff: Array
    least: Array
    bandwidth: Array
    order: int = eqx.field(static=True)

    def __init__(
        self,
        motor: Any,
        sample_time: Any,
        cutoff: Any,
        least: Any,
        bandwidth: Any,
        order: int = 1,
    ) -> None:
        self.motor, self.sample_time = motor, leaf(sample_time)
        self.cutoff, self.least = leaf(cutoff), leaf(least)
        self.bandwidth, self.order = leaf(bandwidth), order

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
        # Bilinear, so that the compensation is exact up to errors of order (ωh)².
        speed = own.pll.speed
        corner = jnp.maximum(self.cutoff * jnp.abs(speed), self.least)
        a = corner * h / 2
        first = ((1 - a) * own.first + volt_seconds) / (1 + a)
        second = ((1 - a) * own.second + first - own.first) / (1 + a)
        least = self.least
        safe = jnp.where(jnp.abs(speed) > least, speed, jnp.where(speed < 0, -least, least))
        give_back = jax.lax.complex(jnp.ones(()), -corner / safe)
        flux = first * give_back if self.order == 1 else second * give_back**2
        theta = angle(self.active(flux, current))
        loop = pll(own.pll, theta, self.bandwidth, h)
        return VoltageModelState(first, second, loop), Guess(theta, loop.speed, flux, loop.theta)
