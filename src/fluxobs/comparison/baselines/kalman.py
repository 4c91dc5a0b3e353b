"""Extended Kalman filter, as published and with the drift as an additional state."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from ...simulation.drive.vectors import pair, turn, wrap
from .base import Baseline, Guess, leaf


class KalmanState(NamedTuple):
    x: Array  # (λ_α, λ_β, ω, θ), and the drift (2,) if it is a state
    P: Array


def corrected(
    x: Array, P: Array, H: Array, innovation: Array, variance: Array
) -> tuple[Array, Array]:
    """State and covariance after two measurements of one variance; Joseph's form."""
    S = H @ P @ H.T + variance * jnp.eye(2)
    det = S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]
    inverse = jnp.array([[S[1, 1], -S[0, 1]], [-S[1, 0], S[0, 0]]]) / det
    K = P @ H.T @ inverse
    left = jnp.eye(len(x)) - K @ H
    return x + K @ innovation, left @ P @ left.T + variance * K @ K.T


class KalmanFilter(Baseline):
    """States are flux, speed and position; the measurement is the current ``i(λ, θ)``; the speed
    is a random walk. Works for salient machines without change.

    Parameters
    ----------
    voltage_noise : float
        Std of the mean voltage over a sample [V]; process noise of the flux.
    acceleration : float
        Random walk of the speed [rad/s per √s].
    current_noise : float
        Std of a current component [A].
    drift_walk : float
        Random walk of the drift [V per √s]; used if the drift is a state.
    with_drift : bool
        Makes the drift a state (not in the references).

    References
    ----------
    S. Bolognani, R. Oboe, M. Zigliotto, "Sensorless full-digital PMSM drive with EKF estimation of
    speed and rotor position", IEEE Trans. Industrial Electronics 46 (1999), doi:10.1109/41.744410;
    the choice of covariances: S. Bolognani, L. Tubiana, M. Zigliotto, "Extended Kalman filter
    tuning in sensorless PMSM drives", IEEE Trans. Industry Applications 39 (2003),
    doi:10.1109/TIA.2003.818991.
    """

    voltage_noise: Array
    acceleration: Array
    current_noise: Array
    drift_walk: Array
    drift_size: Array
    speed_size: Array
    with_drift: bool = eqx.field(static=True)

    def __init__(
        self,
        motor: Any,
        sample_time: Any,
        voltage_noise: Any,
        acceleration: Any,
        current_noise: Any,
        speed_size: Any,
        drift_walk: Any = 0.0,
        drift_size: Any = 1.0,
        with_drift: bool = False,
    ) -> None:
        self.motor, self.sample_time = motor, leaf(sample_time)
        self.voltage_noise, self.acceleration = leaf(voltage_noise), leaf(acceleration)
        self.current_noise, self.drift_walk = leaf(current_noise), leaf(drift_walk)
        self.drift_size, self.speed_size = leaf(drift_size), leaf(speed_size)
        self.with_drift = with_drift

    def start(self) -> KalmanState:
        psi = self.motor.psi_f
        zero = jnp.zeros(())
        x = [psi, zero, zero, zero]
        sizes = [self.size(), self.size(), self.speed_size, jnp.asarray(1.8)]
        if self.with_drift:
            x, sizes = [*x, zero, zero], [*sizes, self.drift_size, self.drift_size]
        return KalmanState(jnp.stack(x), jnp.diag(jnp.stack(sizes) ** 2))

    def advance(
        self, own: KalmanState, voltage: Array, volt_seconds: Array, current: Array, before: Array
    ) -> tuple[KalmanState, Guess]:
        m, h = self.motor, self.sample_time
        v = pair(volt_seconds)
        size = len(own.x)
        F = jnp.eye(size).at[3, 2].set(h)
        noise = [(h * self.voltage_noise) ** 2] * 2 + [h * self.acceleration**2, 0.0]
        if self.with_drift:
            F = F.at[0, 4].set(h).at[1, 5].set(h)
            noise += [h * self.drift_walk**2] * 2
        x = F @ own.x + jnp.zeros(size).at[:2].set(v)
        P = F @ own.P @ F.T + jnp.diag(jnp.stack([jnp.asarray(q) for q in noise]))

        direction = turn(x[3])
        c, s = direction.real, direction.imag
        flux = jax.lax.complex(x[0], x[1])
        predicted = m.current(flux, direction)
        # ∂i/∂λ = e Λ e*, ∂i/∂θ = j i + e Λ (-j λ_dq), Λ = diag(1/L_d, 1/L_q).
        d, q = 1 / m.L_d, 1 / m.L_q
        cross = c * s * (d - q)
        by_flux = jnp.array([[c * c * d + s * s * q, cross], [cross, s * s * d + c * c * q]])
        local = flux * jnp.conj(direction)
        by_angle = 1j * predicted + direction * jax.lax.complex(local.imag * d, -local.real * q)
        H = jnp.zeros((2, size)).at[:, :2].set(by_flux).at[:, 3].set(pair(by_angle))
        x, P = corrected(x, P, H, pair(current - predicted), self.current_noise**2)
        x = x.at[3].set(wrap(x[3]))
        return KalmanState(x, P), Guess(x[3], x[2], jax.lax.complex(x[0], x[1]), x[3])
