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
        k; usually 1, with ζ_∞ = 0.2.
    bandwidth : float
        α [rad/s]; usually 2π 40.

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
        state: SpeedAdaptiveState,
        voltage: Array,
        volt_seconds: Array,
        current: Array,
        previous: Array,
    ) -> tuple[SpeedAdaptiveState, Guess]:
        m, h = self.motor, self.sample_time
        theta = state.theta + h * state.speed
        flux = state.flux + volt_seconds
        to_rotor = jnp.conj(turn(theta))
        i, k = current * to_rotor, m.L_d - m.L_q
        e = m.flux_dq(i) - flux * to_rotor
        auxiliary = jax.lax.complex(m.psi_f + k * i.real, -k * i.imag)
        magnitude_squared = jnp.maximum(
            auxiliary.real**2 + auxiliary.imag**2, (1e-3 * self.size()) ** 2
        )
        relative_error = e * jnp.conj(auxiliary) / magnitude_squared  # e/ψ_a
        b = m.R_s * (1 / m.L_d + 1 / m.L_q) / 2 + 0.4 * jnp.abs(state.speed)
        # Correct only the component along ψ_a, with the exact decay.
        decay = -jnp.expm1(-self.gain * b * h)
        flux = flux + decay * relative_error.real * auxiliary * jnp.conj(to_rotor)
        gain_theta, gain_speed = pll_gains(self.bandwidth, h)
        epsilon = jnp.clip(-relative_error.imag, -1.0, 1.0)
        speed = state.speed + gain_speed * epsilon
        theta = wrap(theta + gain_theta * epsilon)
        return SpeedAdaptiveState(flux, theta, speed), Guess(theta, speed, flux, theta)
