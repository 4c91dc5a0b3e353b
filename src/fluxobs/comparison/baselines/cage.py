"""Observers of the rotor flux of an induction machine, without a speed sensor.

All use the inverse-Γ model ``L_σ di/dt = u - R_s i - dψ/dt``, ``dψ/dt = R_R i - (α - jω_m) ψ``,
with α = R_R/L_M. They start with the rotor flux of a machine at rest, 0; a small one keeps its
direction defined.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from ...simulation.drive.motor import CageMotor
from ...simulation.drive.vectors import length, pair, unit
from .base import Baseline, Guess, PllState, angle, leaf, pll, pll_start
from .kalman import corrected

#: Rotor flux at the start, and the least that is divided by, over the rated one.
LEAST = 1e-3


class CageBaseline(Baseline):
    """What the observers of a cage share."""

    motor: CageMotor

    def least(self) -> Array:
        return LEAST * self.motor.psi_f

    def first(self) -> Array:
        return jax.lax.complex(self.least(), jnp.zeros(()))

    def alpha(self) -> Array:
        """R_R/L_M [1/s]."""
        return self.motor.R_R / self.motor.L_M

    def slip_of(self, psi: Array, current: Array) -> Array:
        """Slip ``R_R i_q/|ψ|`` [rad/s]."""
        i_q = (current * jnp.conj(unit(psi))).imag
        return self.motor.slip(i_q, length(psi))

    def rotor_step(self, psi: Array, mean: Array, speed: Array) -> Array:
        """The rotor flux after one sample of the current model, exact for a constant current."""
        pole = jax.lax.complex(-self.alpha(), speed)
        turned = jnp.exp(pole * self.sample_time)
        return turned * psi + (turned - 1) / pole * self.motor.R_R * mean

    def guess(self, psi: Array, current: Array, speed_s: Array) -> Guess:
        theta = angle(psi)
        return Guess(theta, speed_s, psi + self.motor.L_d * current, theta)


class HybridState(NamedTuple):
    voltage: Array  # rotor flux of the voltage model
    current: Array  # and of the current model
    offset: Array  # integral part of the correction [V]
    pll: PllState


class HybridFluxObserver(CageBaseline):
    """Gopinath's observer: the current model at low, the voltage model at high speed.

    The voltage model's flux is pulled to the current model's by a PI with a double pole at
    `crossover`. The current model turns with the speed that a phase-locked loop finds, less the
    slip.

    Parameters
    ----------
    crossover : float
        [rad/s].
    bandwidth : float
        Bandwidth of the phase-locked loop [rad/s].

    References
    ----------
    P. L. Jansen, R. D. Lorenz, "A physically insightful approach to the design and accuracy
    assessment of flux observers for field oriented induction machine drives", IEEE Trans. Industry
    Applications 30 (1994), doi:10.1109/28.273627.
    """

    crossover: Array
    bandwidth: Array

    def __init__(self, motor: Any, sample_time: Any, crossover: Any, bandwidth: Any) -> None:
        self.motor, self.sample_time = motor, leaf(sample_time)
        self.crossover, self.bandwidth = leaf(crossover), leaf(bandwidth)

    def start(self) -> HybridState:
        return HybridState(self.first(), self.first(), 0 * self.first(), pll_start())

    def advance(
        self, own: HybridState, voltage: Array, volt_seconds: Array, current: Array, before: Array
    ) -> tuple[HybridState, Guess]:
        h, a = self.sample_time, self.crossover
        speed = own.pll.speed - self.slip_of(own.voltage, current)
        modelled = self.rotor_step(own.current, (current + before) / 2, speed)
        off = modelled - own.voltage
        pulled = own.voltage + volt_seconds - self.motor.L_d * (current - before)
        pulled = pulled + h * (2 * a * off + own.offset)
        loop = pll(own.pll, angle(pulled), self.bandwidth, h)
        state = HybridState(pulled, modelled, own.offset + h * a * a * off, loop)
        return state, self.guess(pulled, current, loop.speed)._replace(theta_e_tracked=loop.theta)


class FullOrderState(NamedTuple):
    current: Array
    psi: Array
    integral: Array  # of the speed [rad/s]
    speed: Array


class FullOrderObserver(CageBaseline):
    """Kubota's full-order observer with an adaptive speed.

    A model of stator current and rotor flux; the error e of the current corrects the current with
    `gain`, and the speed by ``Im(e* ψ̂)/|ψ̂|²`` through a PI with a double pole at `bandwidth`.

    Parameters
    ----------
    gain : float
        Added to the decay of the current's error, over (R_s + R_R)/L_σ.
    bandwidth : float
        [rad/s].

    References
    ----------
    H. Kubota, K. Matsuse, T. Nakano, "DSP-based speed adaptive flux observer of induction motor",
    IEEE Trans. Industry Applications 29 (1993), doi:10.1109/28.216542.
    """

    gain: Array
    bandwidth: Array

    def __init__(self, motor: Any, sample_time: Any, gain: Any, bandwidth: Any) -> None:
        self.motor, self.sample_time = motor, leaf(sample_time)
        self.gain, self.bandwidth = leaf(gain), leaf(bandwidth)

    def start(self) -> FullOrderState:
        zero = jnp.zeros(())
        return FullOrderState(0 * self.first(), self.first(), zero, zero)

    def advance(
        self,
        own: FullOrderState,
        voltage: Array,
        volt_seconds: Array,
        current: Array,
        before: Array,
    ) -> tuple[FullOrderState, Guess]:
        m, h = self.motor, self.sample_time
        decay = (m.R_s + m.R_R) / m.L_d
        off = before - own.current

        def rate(i: Array, psi: Array) -> tuple[Array, Array]:
            turning = jax.lax.complex(self.alpha(), -own.speed) * psi
            by_current = (voltage - (m.R_s + m.R_R) * i + turning) / m.L_d
            return by_current + self.gain * decay * off, m.R_R * i - turning

        di, dpsi = rate(own.current, own.psi)
        di, dpsi = rate(own.current + h / 2 * di, own.psi + h / 2 * dpsi)
        i, psi = own.current + h * di, own.psi + h * dpsi
        # The current answers an error of the speed like ψ h/L_σ over its decay.
        size = jnp.maximum(length(psi), self.least())
        error = ((current - i) * jnp.conj(psi)).imag / size**2 * m.L_d * decay * (1 + self.gain)
        error = jnp.clip(-error, -self.bandwidth, self.bandwidth)
        integral = own.integral + h * self.bandwidth**2 / (2 * decay) * error
        speed = integral + self.bandwidth / decay * error
        state = FullOrderState(i, psi, integral, speed)
        return state, self.guess(psi, current, speed + self.slip_of(psi, current))


class ReducedOrderState(NamedTuple):
    psi: Array
    speed: Array  # of the rotor, electrical [rad/s]
    theta: Array


class ReducedOrderObserver(CageBaseline):
    """Hinkkanen, Harnefors and Luomi's reduced-order observer, inherently sensorless.

    The voltage model, corrected along ``k = (α/2 + damping |ω_m|)/(α - jω_m)`` by the part of the
    current model that does not contain the speed: ``R_R i_d - α |ψ|``. The speed is that of the
    flux less the slip, low-passed.

    Parameters
    ----------
    damping : float
        0.2 is usual.
    bandwidth : float
        Of the speed's low-pass [rad/s].

    References
    ----------
    M. Hinkkanen, L. Harnefors, J. Luomi, "Reduced-order flux observers with stator-resistance
    adaptation for speed-sensorless induction motor drives", IEEE Trans. Power Electronics 25
    (2010), doi:10.1109/TPEL.2009.2039650.
    """

    damping: Array
    bandwidth: Array

    def __init__(self, motor: Any, sample_time: Any, damping: Any, bandwidth: Any) -> None:
        self.motor, self.sample_time = motor, leaf(sample_time)
        self.damping, self.bandwidth = leaf(damping), leaf(bandwidth)

    def start(self) -> ReducedOrderState:
        return ReducedOrderState(self.first(), jnp.zeros(()), jnp.zeros(()))

    def advance(
        self,
        own: ReducedOrderState,
        voltage: Array,
        volt_seconds: Array,
        current: Array,
        before: Array,
    ) -> tuple[ReducedOrderState, Guess]:
        m, h, alpha = self.motor, self.sample_time, self.alpha()
        direction = unit(own.psi)
        emf = (volt_seconds - m.L_d * (current - before)) * jnp.conj(direction)
        i_d = ((current + before) / 2 * jnp.conj(direction)).real
        modelled = h * (m.R_R * i_d - alpha * length(own.psi))
        k = (alpha / 2 + self.damping * jnp.abs(own.speed)) / jax.lax.complex(alpha, -own.speed)
        step = emf + k * (modelled - emf.real)
        psi = own.psi + step * direction
        psi = jnp.where(length(psi) > self.least(), psi, self.first())
        turned = angle(psi * jnp.conj(direction)) / h
        follow = -jnp.expm1(-self.bandwidth * h)
        speed = own.speed + follow * (turned - self.slip_of(psi, current) - own.speed)
        state = ReducedOrderState(psi, speed, angle(psi))
        return state, self.guess(psi, current, speed + self.slip_of(psi, current))


class CageKalmanState(NamedTuple):
    x: Array  # stator flux (2), rotor flux (2), rotor speed [rad/s electrical]
    P: Array


class CageKalmanFilter(CageBaseline):
    """Extended Kalman filter; states are stator flux, rotor flux and speed, a random walk.

    Parameters
    ----------
    voltage_noise : float
        Std of the mean voltage over a sample [V]; process noise of both fluxes.
    acceleration : float
        Random walk of the speed [rad/s per √s].
    current_noise, speed_size : float
        Std of a current component [A]; of the speed at the start [rad/s].

    References
    ----------
    Y.-R. Kim, S.-K. Sul, M.-H. Park, "Speed sensorless vector control of induction motor using
    extended Kalman filter", IEEE Trans. Industry Applications 30 (1994), doi:10.1109/28.315233.
    """

    voltage_noise: Array
    acceleration: Array
    current_noise: Array
    speed_size: Array

    def __init__(
        self,
        motor: Any,
        sample_time: Any,
        voltage_noise: Any,
        acceleration: Any,
        current_noise: Any,
        speed_size: Any,
    ) -> None:
        self.motor, self.sample_time = motor, leaf(sample_time)
        self.voltage_noise, self.acceleration = leaf(voltage_noise), leaf(acceleration)
        self.current_noise, self.speed_size = leaf(current_noise), leaf(speed_size)

    def start(self) -> CageKalmanState:
        psi = self.motor.psi_f
        x = jnp.zeros(5).at[2].set(self.least())
        sizes = jnp.stack([psi, psi, psi, psi, self.speed_size])
        return CageKalmanState(x, jnp.diag(sizes**2))

    def advance(
        self,
        own: CageKalmanState,
        voltage: Array,
        volt_seconds: Array,
        current: Array,
        before: Array,
    ) -> tuple[CageKalmanState, Guess]:
        m, h = self.motor, self.sample_time
        mean = (current + before) / 2

        def predicted(x: Array) -> Array:
            psi = self.rotor_step(jax.lax.complex(x[2], x[3]), mean, x[4])
            return jnp.concatenate([x[:2] + pair(volt_seconds), pair(psi), x[4:]])

        x, F = predicted(own.x), jax.jacfwd(predicted)(own.x)
        volts = (h * self.voltage_noise) ** 2
        walk = h * self.acceleration**2
        P = F @ own.P @ F.T + jnp.diag(jnp.stack([volts, volts, volts, volts, walk]))
        H = jnp.array([[1.0, 0.0, -1.0, 0.0, 0.0], [0.0, 1.0, 0.0, -1.0, 0.0]]) / m.L_d
        x, P = corrected(x, P, H, pair(current) - H @ x, self.current_noise**2)
        psi = jax.lax.complex(x[2], x[3])
        guess = self.guess(psi, current, x[4] + self.slip_of(psi, current))
        return CageKalmanState(x, P), guess._replace(flux=jax.lax.complex(x[0], x[1]))
