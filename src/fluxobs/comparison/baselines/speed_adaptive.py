"""Hinkkanen's speed-adaptive flux observer, as in motulator."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from ...simulation.drive.vectors import turn, wrap
from .base import Baseline, Guess, leaf, pll_gains


class SpeedAdaptiveState(NamedTuple):
    flux: Array
    theta: Array
    speed: Array


class SpeedAdaptiveObserver(Baseline):
    """Flux observer corrected along the active flux; a phase-locked loop gives the position.

    In estimated rotor coordinates, with ``e = L_d i_d + j L_q i_q + ψ - λ̂`` and the auxiliary flux
    ``ψ_a = ψ + (L_d - L_q) i*``::

        λ̂' = y + b ψ_a Re(e/ψ_a)             b = k (R (1/L_d + 1/L_q)/2 + 0.4 |ω̂|)
        ω̂' = α² ε,   θ̂' = ω̂ + 2 α ε          ε = -Im(e/ψ_a)

    Parameters
    ----------
    gain : float
        k; 1 is the usual choice, with ζ_∞ = 0.2.
    bandwidth : float
        α [rad/s]; 2π 40 is usual.

    References
    ----------
    M. Hinkkanen, S. E. Saarakkala, H. A. A. Awan, E. Mölsä, T. Tuovinen, "Observers for sensorless
    synchronous motor drives: framework for design and analysis", IEEE Trans. Industry Applications
    54 (2018), doi:10.1109/TIA.2018.2858753.
    """

    gain: Array
    bandwidth: Array

    def __init__(self, motor: Any, sample_time: Any, gain: Any, bandwidth: Any) -> None:
        self.motor, self.sample_time = motor, leaf(sample_time)
        self.gain, self.bandwidth = leaf(gain), leaf(bandwidth)

    def start(self) -> SpeedAdaptiveState:
        zero = jnp.zeros(())
        return SpeedAdaptiveState(jax.lax.complex(self.motor.psi_f, zero), zero, zero)

    def advance(
        self,
        own: SpeedAdaptiveState,
        voltage: Array,
        volt_seconds: Array,
        current: Array,
        before: Array,
    ) -> tuple[SpeedAdaptiveState, Guess]:
        m, h = self.motor, self.sample_time
        theta = own.theta + h * own.speed
        flux = own.flux + volt_seconds
        back = jnp.conj(turn(theta))
        i, k = current * back, m.L_d - m.L_q
        e = m.flux_dq(i) - flux * back
        auxiliary = jax.lax.complex(m.psi_f + k * i.real, -k * i.imag)
        square = jnp.maximum(auxiliary.real**2 + auxiliary.imag**2, (1e-3 * self.size()) ** 2)
        share = e * jnp.conj(auxiliary) / square  # e/ψ_a
        b = m.R_s * (1 / m.L_d + 1 / m.L_q) / 2 + 0.4 * jnp.abs(own.speed)
        # Correct only the part along ψ_a, by its exact decay.
        decay = -jnp.expm1(-self.gain * b * h)
        flux = flux + decay * share.real * auxiliary * jnp.conj(back)
        gain_theta, gain_speed = pll_gains(self.bandwidth, h)
        epsilon = jnp.clip(-share.imag, -1.0, 1.0)
        speed = own.speed + gain_speed * epsilon
        theta = wrap(theta + gain_theta * epsilon)
        return SpeedAdaptiveState(flux, theta, speed), Guess(theta, speed, flux, theta)
