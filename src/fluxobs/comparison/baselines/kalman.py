"""Extended Kalman filter, as published, and with the drift as additional state."""

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


def update_measurement(
    x: Array, P: Array, H: Array, innovation: Array, variance: Array
) -> tuple[Array, Array]:
    """Return (state, covariance) after two measurements of equal variance, in Joseph's form."""
    S = H @ P @ H.T + variance * jnp.eye(2)
    determinant = S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]
    inverse = jnp.array([[S[1, 1], -S[0, 1]], [-S[1, 0], S[0, 0]]]) / determinant
    K = P @ H.T @ inverse
    reduction = jnp.eye(len(x)) - K @ H
    return x + K @ innovation, reduction @ P @ reduction.T + variance * K @ K.T


class KalmanFilter(Baseline):
    """Extended Kalman filter with the states flux, speed and position.

    The measurement is the current ``i(λ, θ)``; the speed is a random walk. Also for salient
    machines.

    Parameters
    ----------
    voltage_noise : float
        Std of the mean voltage over a sample [V], the process noise of the flux.
    acceleration : float
        Random walk of the speed [rad/s per √s].
    current_noise : float
        Std of a current component [A].
    drift_walk : float
        Random walk of the drift [V per √s]; used if the drift is a state.
    with_drift : bool
        Whether the drift is a state (not in the references).

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
        stds = [self.size(), self.size(), self.speed_size, jnp.asarray(1.8)]
        if self.with_drift:
            x, stds = [*x, zero, zero], [*stds, self.drift_size, self.drift_size]
        return KalmanState(jnp.stack(x), jnp.diag(jnp.stack(stds) ** 2))

    def advance(
        self,
        state: KalmanState,
        voltage: Array,
        volt_seconds: Array,
        current: Array,
        previous: Array,
    ) -> tuple[KalmanState, Guess]:
        m, h = self.motor, self.sample_time
        v = pair(volt_seconds)
        dimension = len(state.x)
        F = jnp.eye(dimension).at[3, 2].set(h)
        variances = [(h * self.voltage_noise) ** 2] * 2 + [h * self.acceleration**2, 0.0]
        if self.with_drift:
            F = F.at[0, 4].set(h).at[1, 5].set(h)
            variances += [h * self.drift_walk**2] * 2
        x = F @ state.x + jnp.zeros(dimension).at[:2].set(v)
        P = F @ state.P @ F.T + jnp.diag(jnp.stack([jnp.asarray(q) for q in variances]))

        direction = turn(x[3])
        c, s = direction.real, direction.imag
        flux = jax.lax.complex(x[0], x[1])
        predicted = m.current(flux, direction)
        # ∂i/∂λ = e Λ e*, ∂i/∂θ = j i + e Λ (-j λ_dq), Λ = diag(1/L_d, 1/L_q).
        d, q = 1 / m.L_d, 1 / m.L_q
        off_diagonal = c * s * (d - q)
        flux_jacobian = jnp.array(
            [[c * c * d + s * s * q, off_diagonal], [off_diagonal, s * s * d + c * c * q]]
        )
        rotor_flux = flux * jnp.conj(direction)
        angle_derivative = 1j * predicted + direction * jax.lax.complex(
            rotor_flux.imag * d, -rotor_flux.real * q
        )
        H = (
            jnp.zeros((2, dimension))
            .at[:, :2]
            .set(flux_jacobian)
            .at[:, 3]
            .set(pair(angle_derivative))
        )
        x, P = update_measurement(x, P, H, pair(current - predicted), self.current_noise**2)
        x = x.at[3].set(wrap(x[3]))
        return KalmanState(x, P), Guess(x[3], x[2], jax.lax.complex(x[0], x[1]), x[3])
