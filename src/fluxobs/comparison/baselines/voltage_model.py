"""Voltage model with filters instead of the integrator, compensated at the present speed."""

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
    """Voltage model with a low-pass instead of the integrator, and optionally a high-pass.

    The low-pass is ``λ_c' = y - ω_c λ_c`` (order 1); the high-pass blocks offsets (order 2). ω_c is
    proportional to the speed, but at least `least`. Gain and phase of the filters at the present
    speed are compensated: ``λ̂ = λ_c (1 - jω_c/ω̂)^order``.

    Parameters
    ----------
    cutoff, least : float
        Ratio ω_c/|ω̂|; smallest ω_c [rad/s].
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
        state: VoltageModelState,
        voltage: Array,
        volt_seconds: Array,
        current: Array,
        previous: Array,
    ) -> tuple[VoltageModelState, Guess]:
        h = self.sample_time
        # Bilinear: the compensation is exact up to errors of order (ωh)².
        speed = state.pll.speed
        corner = jnp.maximum(self.cutoff * jnp.abs(speed), self.least)
        a = corner * h / 2
        first = ((1 - a) * state.first + volt_seconds) / (1 + a)
        second = ((1 - a) * state.second + first - state.first) / (1 + a)
        least = self.least
        bounded_speed = jnp.where(
            jnp.abs(speed) > least, speed, jnp.where(speed < 0, -least, least)
        )
        compensation = jax.lax.complex(jnp.ones(()), -corner / bounded_speed)
        flux = first * compensation if self.order == 1 else second * compensation**2
        theta = angle(self.active(flux, current))
        loop = pll(state.pll, theta, self.bandwidth, h)
        return VoltageModelState(first, second, loop), Guess(theta, loop.speed, flux, loop.theta)
