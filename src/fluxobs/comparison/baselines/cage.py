"""Observers of the rotor flux of an induction machine, without a speed sensor.

All observers use the inverse-Γ model ``L_σ di/dt = u - R_s i - dψ/dt``, ``dψ/dt = R_R i - (α -
jω_m) ψ``, with α = R_R/L_M. The observers start as for a machine at rest, but with a small rotor
flux instead of 0, so that the flux has a direction.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from ...simulation.drive.motor import CageMotor
from ...simulation.drive.vectors import length, pair, unit
from .base import Baseline, Guess, PllState, angle, leaf, pll, pll_start
from .kalman import update_measurement

#: Rotor flux at the start and lower limit of divisors, relative to the rated flux.
LEAST = 1e-3


class CageBaseline(Baseline):
    """Base of the observers of a cage."""

    motor: CageMotor

    def least_flux(self) -> Array:
        """Return the lower limit of the rotor flux [Wb]."""
        return LEAST * self.motor.psi_f

    def initial_flux(self) -> Array:
        """Return the rotor flux at the start [Wb]."""
        return jax.lax.complex(self.least_flux(), jnp.zeros(()))

    def alpha(self) -> Array:
        """Return R_R/L_M [1/s]."""
        return self.motor.R_R / self.motor.L_M

    def slip_of(self, psi: Array, current: Array) -> Array:
        """Return the slip ``R_R i_q/|ψ|`` [rad/s]."""
        i_q = (current * jnp.conj(unit(psi))).imag
        return self.motor.slip(i_q, length(psi))

    def rotor_step(self, psi: Array, mean_current: Array, speed: Array) -> Array:
        """Advance the rotor flux by one sample of the current model, exact for constant current."""
        pole = jax.lax.complex(-self.alpha(), speed)
        transition = jnp.exp(pole * self.sample_time)
        return transition * psi + (transition - 1) / pole * self.motor.R_R * mean_current

    def guess(self, psi: Array, current: Array, speed_s: Array) -> Guess:
        theta = angle(psi)
        return Guess(theta, speed_s, psi + self.motor.L_d * current, theta)


class HybridState(NamedTuple):
    voltage: Array  # rotor flux of the voltage model [Wb]
    current: Array  # rotor flux of the current model [Wb]
    offset: Array  # integral of the correction [V]
    pll: PllState


class HybridFluxObserver(CageBaseline):
    """Gopinath's observer: current model at low speed, voltage model at high speed.

    A PI controller with a double pole at `crossover` corrects the flux of the voltage model towards
    the flux of the current model. The current model uses the speed of a phase-locked loop, less the
    slip.

    Parameters
    ----------
    crossover : float
        Frequency of the transition between the models [rad/s].
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
        return HybridState(
            self.initial_flux(), self.initial_flux(), 0 * self.initial_flux(), pll_start()
        )

    def advance(
        self,
        state: HybridState,
        voltage: Array,
        volt_seconds: Array,
        current: Array,
        previous: Array,
    ) -> tuple[HybridState, Guess]:
        h, a = self.sample_time, self.crossover
        speed = state.pll.speed - self.slip_of(state.voltage, current)
        current_model = self.rotor_step(state.current, (current + previous) / 2, speed)
        difference = current_model - state.voltage
        corrected = state.voltage + volt_seconds - self.motor.L_d * (current - previous)
        corrected = corrected + h * (2 * a * difference + state.offset)
        loop = pll(state.pll, angle(corrected), self.bandwidth, h)
        next_state = HybridState(
            corrected, current_model, state.offset + h * a * a * difference, loop
        )
        return next_state, self.guess(corrected, current, loop.speed)._replace(
            theta_e_tracked=loop.theta
        )


class FullOrderState(NamedTuple):
    current: Array
    psi: Array
    integral: Array  # integral part of the speed [rad/s]
    speed: Array


class FullOrderObserver(CageBaseline):
    """Kubota's full-order observer with an adaptive speed.

    The observer is a model of stator current and rotor flux. The current error e corrects the
    current with `gain`, and the speed with ``Im(e* ψ̂)/|ψ̂|²`` through a PI with a double pole at
    `bandwidth`.

    Parameters
    ----------
    gain : float
        Additional decay rate of the current error, relative to (R_s + R_R)/L_σ.
    bandwidth : float
        Bandwidth of the speed [rad/s].

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
        return FullOrderState(0 * self.initial_flux(), self.initial_flux(), zero, zero)

    def advance(
        self,
        state: FullOrderState,
        voltage: Array,
        volt_seconds: Array,
        current: Array,
        previous: Array,
    ) -> tuple[FullOrderState, Guess]:
        m, h = self.motor, self.sample_time
        decay = (m.R_s + m.R_R) / m.L_d
        current_error = previous - state.current

        def rate(i: Array, psi: Array) -> tuple[Array, Array]:
            rotor_emf = jax.lax.complex(self.alpha(), -state.speed) * psi
            by_current = (voltage - (m.R_s + m.R_R) * i + rotor_emf) / m.L_d
            return by_current + self.gain * decay * current_error, m.R_R * i - rotor_emf

        di, dpsi = rate(state.current, state.psi)
        di, dpsi = rate(state.current + h / 2 * di, state.psi + h / 2 * dpsi)
        i, psi = state.current + h * di, state.psi + h * dpsi
        # A constant speed error Δω causes a current error of ψ Δω/(L_σ decay (1 + gain)).
        magnitude = jnp.maximum(length(psi), self.least_flux())
        error = (
            ((current - i) * jnp.conj(psi)).imag / magnitude**2 * m.L_d * decay * (1 + self.gain)
        )
        error = jnp.clip(-error, -self.bandwidth, self.bandwidth)
        integral = state.integral + h * self.bandwidth**2 / (2 * decay) * error
        speed = integral + self.bandwidth / decay * error
        next_state = FullOrderState(i, psi, integral, speed)
        return next_state, self.guess(psi, current, speed + self.slip_of(psi, current))


class ReducedOrderState(NamedTuple):
    psi: Array
    speed: Array  # electrical speed of the rotor [rad/s]
    theta: Array


class ReducedOrderObserver(CageBaseline):
    """Hinkkanen, Harnefors and Luomi's reduced-order observer, inherently sensorless.

    The voltage model is corrected along ``k = (α/2 + damping |ω_m|)/(α - jω_m)`` by the part of the
    current model that does not contain the speed: ``R_R i_d - α |ψ|``. The speed is the speed of
    the flux less the slip, low-passed.

    Parameters
    ----------
    damping : float
        Usually 0.2.
    bandwidth : float
        Bandwidth of the speed's low-pass [rad/s].

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
        return ReducedOrderState(self.initial_flux(), jnp.zeros(()), jnp.zeros(()))

    def advance(
        self,
        state: ReducedOrderState,
        voltage: Array,
        volt_seconds: Array,
        current: Array,
        previous: Array,
    ) -> tuple[ReducedOrderState, Guess]:
        m, h, alpha = self.motor, self.sample_time, self.alpha()
        direction = unit(state.psi)
        emf = (volt_seconds - m.L_d * (current - previous)) * jnp.conj(direction)
        i_d = ((current + previous) / 2 * jnp.conj(direction)).real
        current_model = h * (m.R_R * i_d - alpha * length(state.psi))
        k = (alpha / 2 + self.damping * jnp.abs(state.speed)) / jax.lax.complex(alpha, -state.speed)
        flux_step = emf + k * (current_model - emf.real)
        psi = state.psi + flux_step * direction
        psi = jnp.where(length(psi) > self.least_flux(), psi, self.initial_flux())
        flux_speed = angle(psi * jnp.conj(direction)) / h
        gain = -jnp.expm1(-self.bandwidth * h)
        speed = state.speed + gain * (flux_speed - self.slip_of(psi, current) - state.speed)
        next_state = ReducedOrderState(psi, speed, angle(psi))
        return next_state, self.guess(psi, current, speed + self.slip_of(psi, current))


class CageKalmanState(NamedTuple):
    x: Array  # stator flux (2,), rotor flux (2,), electrical rotor speed [rad/s]
    P: Array


class CageKalmanFilter(CageBaseline):
    """Extended Kalman filter with the states stator flux, rotor flux and speed (a random walk).

    Parameters
    ----------
    voltage_noise : float
        Std of the mean voltage over a sample [V], the process noise of both fluxes.
    acceleration : float
        Random walk of the speed [rad/s per √s].
    current_noise, speed_size : float
        Std of a current component [A]; std of the speed at the start [rad/s].

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
        x = jnp.zeros(5).at[2].set(self.least_flux())
        stds = jnp.stack([psi, psi, psi, psi, self.speed_size])
        return CageKalmanState(x, jnp.diag(stds**2))

    def advance(
        self,
        state: CageKalmanState,
        voltage: Array,
        volt_seconds: Array,
        current: Array,
        previous: Array,
    ) -> tuple[CageKalmanState, Guess]:
        m, h = self.motor, self.sample_time
        mean_current = (current + previous) / 2

        def predict(x: Array) -> Array:
            psi = self.rotor_step(jax.lax.complex(x[2], x[3]), mean_current, x[4])
            return jnp.concatenate([x[:2] + pair(volt_seconds), pair(psi), x[4:]])

        x, F = predict(state.x), jax.jacfwd(predict)(state.x)
        flux_variance = (h * self.voltage_noise) ** 2
        speed_variance = h * self.acceleration**2
        P = F @ state.P @ F.T + jnp.diag(
            jnp.stack([flux_variance, flux_variance, flux_variance, flux_variance, speed_variance])
        )
        H = jnp.array([[1.0, 0.0, -1.0, 0.0, 0.0], [0.0, 1.0, 0.0, -1.0, 0.0]]) / m.L_d
        x, P = update_measurement(x, P, H, pair(current) - H @ x, self.current_noise**2)
        psi = jax.lax.complex(x[2], x[3])
        guess = self.guess(psi, current, x[4] + self.slip_of(psi, current))
        return CageKalmanState(x, P), guess._replace(flux=jax.lax.complex(x[0], x[1]))
