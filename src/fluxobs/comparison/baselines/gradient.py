"""The gradient observer on the length of the active flux, and the clamp for infinite gain."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from ...simulation.drive.vectors import length, unit
from .base import Baseline, Guess, PllState, angle, leaf, pll, pll_start


class GradientState(NamedTuple):
    active: Array
    psi: Array
    pll: PllState


class LengthGradient(Baseline):
    """Non-linear observer of ODrive and VESC: ``x' = y - L_q di/dt + g/2 (1 - |x|²/ψ²) x``.

    With `adaptation` the observer also estimates the length, by the gradient of the same error (the
    magnitude-adapting variant): ``ψ̂' = -g_ψ/2 (1 - |x|²/ψ̂²) ψ̂``.

    Parameters
    ----------
    gain : float
        g [1/s]; decay rate of a length error.
    adaptation : float
        g_ψ [1/s]; 0 switches the adaptation off.
    bandwidth : float
        Bandwidth of the phase-locked loop for the speed [rad/s].

    References
    ----------
    J. Lee, J. Hong, K. Nam, R. Ortega, L. Praly, A. Astolfi, "Sensorless control of surface-mount
    permanent-magnet synchronous motors based on a nonlinear observer", IEEE Trans. Power
    Electronics 25 (2010), doi:10.1109/TPEL.2009.2025276; F. A. G. Henwood, J. Malaizé, L. Praly,
    "A robust nonlinear Luenberger observer for the sensorless control of SM-PMSM: rotor position
    and magnets flux estimation", IECON 2012, doi:10.1109/IECON.2012.6388727.
    """

    gain: Array
    adaptation: Array
    bandwidth: Array

    def __init__(
        self, motor: Any, sample_time: Any, gain: Any, bandwidth: Any, adaptation: Any = 0.0
    ) -> None:
        self.motor, self.sample_time = motor, leaf(sample_time)
        self.gain, self.bandwidth = leaf(gain), leaf(bandwidth)
        self.adaptation = leaf(adaptation)

    def start(self) -> GradientState:
        return GradientState(
            jax.lax.complex(self.size(), jnp.zeros(())), self.motor.psi_f, pll_start()
        )

    def advance(
        self,
        state: GradientState,
        voltage: Array,
        volt_seconds: Array,
        current: Array,
        previous: Array,
    ) -> tuple[GradientState, Guess]:
        h = self.sample_time
        x = state.active + volt_seconds - self.motor.L_q * (current - previous)
        target_length = self.length(current, unit(x)) - self.motor.psi_f + state.psi
        target_length = jnp.maximum(target_length, 1e-3 * self.size())
        length_error = 1 - jnp.minimum((length(x) / target_length) ** 2, 4.0)
        x = x * jnp.exp(h * self.gain / 2 * length_error)
        psi = state.psi * jnp.exp(-h * self.adaptation / 2 * length_error)
        theta = angle(x)
        loop = pll(state.pll, theta, self.bandwidth, h)
        flux = x + self.motor.L_q * current
        return GradientState(x, psi, loop), Guess(theta, loop.speed, flux, loop.theta)


class ClampedState(NamedTuple):
    active: Array
    pll: PllState


class ClampedIntegrator(Baseline):
    """Clamped integrator (MXLEMMING): ``x' = y - L_q di/dt``, each axis clamped to ±|x|.

    Published only as a description and in firmware (MESC project). Its only gain is the level of
    the clamp.

    Parameters
    ----------
    level : float
        Level of the clamp relative to ψ + (L_d - L_q) i_d; nominally 1.
    bandwidth : float
        Bandwidth of the phase-locked loop for the speed [rad/s].
    """

    level: Array
    bandwidth: Array

    def __init__(self, motor: Any, sample_time: Any, level: Any, bandwidth: Any) -> None:
        self.motor, self.sample_time = motor, leaf(sample_time)
        self.level, self.bandwidth = leaf(level), leaf(bandwidth)

    def start(self) -> ClampedState:
        return ClampedState(jax.lax.complex(self.size(), jnp.zeros(())), pll_start())

    def advance(
        self,
        state: ClampedState,
        voltage: Array,
        volt_seconds: Array,
        current: Array,
        previous: Array,
    ) -> tuple[ClampedState, Guess]:
        x = state.active + volt_seconds - self.motor.L_q * (current - previous)
        limit = self.level * self.length(current, unit(x))
        x = jax.lax.complex(jnp.clip(x.real, -limit, limit), jnp.clip(x.imag, -limit, limit))
        theta = angle(x)
        loop = pll(state.pll, theta, self.bandwidth, self.sample_time)
        flux = x + self.motor.L_q * current
        return ClampedState(x, loop), Guess(theta, loop.speed, flux, loop.theta)
