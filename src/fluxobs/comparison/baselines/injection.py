"""Position from an injected square wave: demodulation and a phase-locked loop."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from ...simulation.drive.vectors import turn, wrap
from .base import Baseline, Guess, PllState, leaf, pll_gains, pll_start

#: A change of the flux below this share of the machine's is no injection.
LEAST_CHANGE = 1e-4
#: Low-pass of the EMF that decides the half turn [rad/s], and the share of the expected EMF that it
#: must have, with the wrong sign.
POLARITY_CUTOFF, POLARITY_SHARE = 50.0, 0.5


class InjectionState(NamedTuple):
    volt_seconds: Array
    change: Array
    emf: Array
    pll: PllState


class SquareWaveInjection(Baseline):
    """Square wave at half the sampling rate: half differences of currents, demodulated, and a PLL.

    Half the difference of two changes of the current has no fundamental. The part of it across the
    estimated d axis that the inductances do not explain is the angle's error times the saliency;
    the loop integrates it. The sign of the EMF decides the half turn once the rotor turns.

    Parameters
    ----------
    bandwidth : float
        Bandwidth of the phase-locked loop [rad/s].

    References
    ----------
    Y.-D. Yoon, S.-K. Sul, S. Morimoto, K. Ide, "High-bandwidth sensorless algorithm for AC machines
    based on square-wave-type voltage injection", IEEE Trans. Industry Applications 47 (2011),
    doi:10.1109/TIA.2011.2126552.
    """

    bandwidth: Array

    def __init__(self, motor: Any, sample_time: Any, bandwidth: Any) -> None:
        self.motor, self.sample_time = motor, leaf(sample_time)
        self.bandwidth = leaf(bandwidth)

    def start(self) -> InjectionState:
        zero = jax.lax.complex(jnp.zeros(()), jnp.zeros(()))
        return InjectionState(zero, zero, jnp.zeros(()), pll_start())

    def advance(
        self,
        state: InjectionState,
        voltage: Array,
        volt_seconds: Array,
        current: Array,
        previous: Array,
    ) -> tuple[InjectionState, Guess]:
        m, h = self.motor, self.sample_time
        change = current - previous
        predicted = state.pll.theta + h * state.pll.speed
        back = turn(-predicted)
        flux = back * (volt_seconds - state.volt_seconds) / 2
        response = back * (change - state.change) / 2
        saliency = m.L_d - m.L_q
        # Current that the flux would cause with the estimated axis, and its saliency across.
        expected = jax.lax.complex(flux.real / m.L_d, flux.imag / m.L_q)
        rest = flux - jax.lax.complex(m.L_d * response.real, m.L_q * response.imag)
        beside = saliency * jax.lax.complex(expected.imag, expected.real)
        square = jnp.abs(beside) ** 2
        floor = (LEAST_CHANGE * self.size() * saliency / m.L_d) ** 2
        error = (rest.real * beside.real + rest.imag * beside.imag) / (square + floor + 1e-300)
        gain_theta, gain_speed = pll_gains(self.bandwidth, h)
        error = jnp.clip(error, -0.5, 0.5)
        speed = state.pll.speed + gain_speed * error
        theta = wrap(predicted + gain_theta * error)
        # EMF along q; where it contradicts the direction of rotation, the axis is half a turn off.
        share = 1 - jnp.exp(-POLARITY_CUTOFF * h)
        across = (turn(-theta) * (volt_seconds - m.L_q * change) / h).imag
        direction = jnp.where(speed < 0, -1.0, 1.0)
        emf = state.emf + share * (direction * across - state.emf)
        wrong = emf < -POLARITY_SHARE * self.size() * jnp.abs(speed)
        turned = wrong & (emf < -POLARITY_SHARE * self.size() * POLARITY_CUTOFF / 10)
        theta = jnp.where(turned, wrap(theta + jnp.pi), theta)
        emf = jnp.where(turned, -emf, emf)
        loop = PllState(theta, speed)
        x = self.length(current, turn(theta)) * turn(theta)
        state = InjectionState(volt_seconds, change, emf, loop)
        return state, Guess(theta, speed, x + m.L_q * current, theta)
