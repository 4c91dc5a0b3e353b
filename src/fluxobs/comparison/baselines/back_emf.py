"""Position from the back EMF: extended EMF with a disturbance observer, and sliding mode."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from ...simulation.drive.vectors import turn
from .base import Baseline, Guess, PllState, angle, leaf, pll, pll_start


def _lag(decay: Array, rotation: Array) -> Array:
    """Return the phase lag of ``y ← decay y + (1 - decay) x``; x turns by `rotation` per sample."""
    return jnp.arctan2(decay * jnp.sin(rotation), 1 - decay * jnp.cos(rotation))


def _rotor_angle(emf: Array, speed: Array, lag: Array) -> Array:
    """Return the rotor angle θ from an EMF ``j ω ψ exp(jθ)`` that a filter delays by `lag`."""
    return angle(emf) - jnp.where(speed < 0, -1.0, 1.0) * jnp.pi / 2 + lag


class EmfState(NamedTuple):
    emf: Array
    pll: PllState


class ExtendedEmf(Baseline):
    """Extended EMF with a disturbance observer and a phase-locked loop.

    The EMF e of ``u = R i + L_d di/dt - jω(L_d - L_q) i + e`` is filtered by ω_c/(s + ω_c); a
    phase-locked loop tracks its angle.

    Parameters
    ----------
    cutoff : float
        ω_c of the disturbance observer [rad/s].
    bandwidth : float
        Bandwidth of the phase-locked loop [rad/s].

    References
    ----------
    Z. Chen, M. Tomita, S. Doki, S. Okuma, "An extended electromotive force model for sensorless
    control of interior permanent-magnet synchronous motors", IEEE Trans. Industrial Electronics 50
    (2003), doi:10.1109/TIE.2003.809391.
    """

    cutoff: Array
    bandwidth: Array

    def __init__(self, motor: Any, sample_time: Any, cutoff: Any, bandwidth: Any) -> None:
        self.motor, self.sample_time = motor, leaf(sample_time)
        self.cutoff, self.bandwidth = leaf(cutoff), leaf(bandwidth)

    def start(self) -> EmfState:
        zero = jnp.zeros(())
        return EmfState(jax.lax.complex(zero, zero), pll_start())

    def advance(
        self, state: EmfState, voltage: Array, volt_seconds: Array, current: Array, previous: Array
    ) -> tuple[EmfState, Guess]:
        m, h = self.motor, self.sample_time
        speed = state.pll.speed
        cross_coupling = (m.L_d - m.L_q) * speed * (current + previous) / 2
        unfiltered = (volt_seconds - m.L_d * (current - previous)) / h + 1j * cross_coupling
        decay = jnp.exp(-self.cutoff * h)
        emf = decay * state.emf + (1 - decay) * unfiltered
        # The mean EMF over the interval is half a sample old.
        theta = _rotor_angle(emf, speed, _lag(decay, speed * h) + speed * h / 2)
        loop = pll(state.pll, theta, self.bandwidth, h)
        x = self.length(current, turn(loop.theta)) * turn(loop.theta)
        return EmfState(emf, loop), Guess(loop.theta, loop.speed, x + m.L_q * current, loop.theta)


class SlidingState(NamedTuple):
    current: Array
    forced: Array
    emf: Array
    pll: PllState


class SlidingMode(Baseline):
    """Sliding mode: a switched voltage forces a current model onto the measured current.

    ``L_q î' = u - R î - z`` with ``z = K sat((î - i)/Φ)`` on each axis. After a low-pass, z is the
    back EMF of the active flux.

    Parameters
    ----------
    switching : float
        K [V]; must exceed the largest EMF.
    cutoff : float
        Cutoff of the low-pass on z [rad/s].
    bandwidth : float
        Bandwidth of the phase-locked loop [rad/s].

    Notes
    -----
    The boundary layer Φ = 2 K h/L_q is as thin as sampling allows: inside the layer each sample
    halves the current error.

    References
    ----------
    V. Utkin, J. Guldner, J. Shi, *Sliding Mode Control in Electro-Mechanical Systems*, CRC Press
    2009; S. Chi, Z. Zhang, L. Xu, "Sliding-mode sensorless control of direct-drive PM synchronous
    motors for washing machine applications", IEEE Trans. Industry Applications 45 (2009),
    doi:10.1109/TIA.2009.2013545.
    """

    switching: Array
    cutoff: Array
    bandwidth: Array

    def __init__(
        self, motor: Any, sample_time: Any, switching: Any, cutoff: Any, bandwidth: Any
    ) -> None:
        self.motor, self.sample_time = motor, leaf(sample_time)
        self.switching, self.cutoff = leaf(switching), leaf(cutoff)
        self.bandwidth = leaf(bandwidth)

    def start(self) -> SlidingState:
        zero = jax.lax.complex(jnp.zeros(()), jnp.zeros(()))
        return SlidingState(zero, zero, zero, pll_start())

    def advance(
        self,
        state: SlidingState,
        voltage: Array,
        volt_seconds: Array,
        current: Array,
        previous: Array,
    ) -> tuple[SlidingState, Guess]:
        m, h = self.motor, self.sample_time
        decay = jnp.exp(-m.R_s * h / m.L_q)
        modelled = decay * state.current + (1 - decay) / m.R_s * (voltage - state.forced)
        layer = 2 * self.switching * h / m.L_q
        saturation = (modelled - current) / layer
        forced = self.switching * jax.lax.complex(
            jnp.clip(saturation.real, -1.0, 1.0), jnp.clip(saturation.imag, -1.0, 1.0)
        )
        filter_decay = jnp.exp(-self.cutoff * h)
        emf = filter_decay * state.emf + (1 - filter_decay) * forced
        speed = state.pll.speed
        # Inside the layer, ``forced`` is the mean EMF of the interval, low-passed with decay 1/2.
        rotation = speed * h
        layer_decay = jnp.asarray(0.5)
        theta = _rotor_angle(
            emf, speed, _lag(layer_decay, rotation) + _lag(filter_decay, rotation) + rotation / 2
        )
        loop = pll(state.pll, theta, self.bandwidth, h)
        x = self.length(current, turn(loop.theta)) * turn(loop.theta)
        return SlidingState(modelled, forced, emf, loop), Guess(
            loop.theta, loop.speed, x + m.L_q * current, loop.theta
        )
