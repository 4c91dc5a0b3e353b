"""The paper's two observers as printed, and the repaired second observer."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from .. import Parametrisation, Regressors
from .base import flow_gain, positive_definite


class RobustObserver(eqx.Module):
    """Proposition 1: ``λ̂' = y_m + Γ Φ_λ (y - Φ_λᵀ λ̂)``; the constants act as disturbances.

    The error converges to a bound proportional to the biases
    (:mod:`fluxobs.research.analysis.bounds`).

    Parameters
    ----------
    Gamma : number, (n,) or (n, n)
        Positive definite gain; Γ |Φ_λ|² is a rate [1/s].
    n : int
        Number of ports.
    """

    Gamma: jax.Array

    def __init__(self, Gamma: Any, n: int) -> None:
        self.Gamma = positive_definite("Gamma", Gamma, n)

    def init(self) -> jax.Array:
        return jnp.zeros(len(self.Gamma))

    def derivative(self, state: jax.Array, y_m: jax.Array, row: Regressors) -> jax.Array:
        return y_m + self.Gamma @ row.Phi_flux * (row.y - row.Phi_flux @ state)

    def step(
        self, state: jax.Array, h: float, volt_seconds: jax.Array, row: Regressors
    ) -> jax.Array:
        flux = state + volt_seconds
        direction = self.Gamma @ row.Phi_flux
        gain = flow_gain(row.Phi_flux @ direction, h)
        return flux + gain * direction * (row.y - row.Phi_flux @ flux)

    def estimate(self, state: jax.Array) -> tuple[jax.Array, jax.Array]:
        return state, jnp.zeros(0)


class PrintedAdaptiveObserver(eqx.Module):
    """Proposition 2 as printed: ``(λ̂, θ̂)' = (y_m + θ̂_drift, 0) + Γ Ψ (y - Ψᵀ(λ̂, θ̂))``.

    Use this law only for reference. The proposition is false: on some machines and trajectories
    with persistently exciting Ψ the law is unstable at every gain (docs/errata.md, 6). Use
    :class:`RepairedAdaptiveObserver`, or check with :mod:`fluxobs.research.analysis.stability`.

    Parameters
    ----------
    Gamma : number, vector or matrix
        Positive definite gain of size n + n_θ. The paper's γ_a is a number or a diagonal matrix.
    constants : Parametrisation
    """

    Gamma: jax.Array
    constants: Parametrisation

    def __init__(self, Gamma: Any, constants: Parametrisation) -> None:
        self.Gamma = positive_definite("Gamma", Gamma, constants.n + len(constants))
        self.constants = constants

    def init(self) -> jax.Array:
        return jnp.zeros(len(self.Gamma))

    def derivative(self, state: jax.Array, y_m: jax.Array, row: Regressors) -> jax.Array:
        n, psi = self.constants.n, self.constants.psi(row)
        feedforward = jnp.zeros_like(state).at[:n].set(y_m + state[n : 2 * n])
        return feedforward + self.Gamma @ psi * (row.y - psi @ state)

    def step(
        self, state: jax.Array, h: float, volt_seconds: jax.Array, row: Regressors
    ) -> jax.Array:
        n, psi = self.constants.n, self.constants.psi(row)
        state = state.at[:n].add(volt_seconds + h * state[n : 2 * n])
        direction = self.Gamma @ psi
        gain = flow_gain(psi @ direction, h)
        return state + gain * direction * (row.y - psi @ state)

    def estimate(self, state: jax.Array) -> tuple[jax.Array, jax.Array]:
        return state[: self.constants.n], state[self.constants.n :]


def sensitivity_step(
    Gamma: jax.Array, U: jax.Array, h: float, Phi: jax.Array, Phi_theta: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (U after a sample, Ω at the sample, K) of :class:`RepairedAdaptiveObserver`.

    K is the flux gain. The three depend neither on the estimates nor on the gain of the constants.
    """
    U = U + h * jnp.eye(U.shape[0], U.shape[1])
    omega = U.T @ Phi + Phi_theta
    direction = Gamma @ Phi
    K = flow_gain(Phi @ direction, h) * direction
    return U - jnp.outer(K, omega), omega, K


class RepairedState(NamedTuple):
    """Estimates, and sensitivity U of the flux error to the error of the constants."""

    flux: jax.Array
    constants: jax.Array
    U: jax.Array


class RepairedAdaptiveObserver(eqx.Module):
    """Repaired Proposition 2, based on Zhang's adaptive observer for time-varying systems::

        λ̂' = y_m + [I 0] θ̂ + Γ Φ_λ e + U θ̂'      e = y - Φ_λᵀ λ̂ - Φ_θᵀ θ̂
        U' = [I 0] - Γ Φ_λ (Φ_λᵀ U + Φ_θᵀ)       θ̂' = G Ω e,  Ω = Uᵀ Φ_λ + Φ_θ

    The error is a cascade: ``η = λ̃ - U θ̃`` obeys ``η' = -Γ Φ_λ Φ_λᵀ η``, and η drives
    ``θ̃' = -G Ω Ωᵀ θ̃ - G Ω Φ_λᵀ η``. The cascade is exponentially stable for any positive gains if
    Φ_λ and Ω are persistently exciting. Moderate gains converge fastest.

    Parameters
    ----------
    Gamma : number, (n,) or (n, n)
        Positive definite flux gain.
    G : number, (n_θ,) or (n_θ, n_θ)
        Positive definite gain of the constants.
    constants : Parametrisation

    References
    ----------
    Q. Zhang, "Adaptive observer for multiple-input-multiple-output (MIMO) linear time-varying
    systems", IEEE Trans. Automatic Control 47 (2002), doi:10.1109/9.989154.
    docs/theory.md, section 10.
    """

    Gamma: jax.Array
    G: jax.Array
    constants: Parametrisation

    def __init__(self, Gamma: Any, G: Any, constants: Parametrisation) -> None:
        self.Gamma = positive_definite("Gamma", Gamma, constants.n)
        self.G = positive_definite("G", G, len(constants))
        self.constants = constants

    def init(self) -> RepairedState:
        n, count = self.constants.n, len(self.constants)
        return RepairedState(jnp.zeros(n), jnp.zeros(count), jnp.zeros((n, count)))

    def derivative(self, state: RepairedState, y_m: jax.Array, row: Regressors) -> RepairedState:
        n, Phi, Phi_theta = self.constants.n, row.Phi_flux, self.constants.regressor(row)
        e = row.y - Phi @ state.flux - Phi_theta @ state.constants
        omega = state.U.T @ Phi + Phi_theta
        rate = self.G @ omega * e
        drift = state.constants[:n]
        flux = y_m + drift + self.Gamma @ Phi * e + state.U @ rate
        U = jnp.eye(n, len(self.constants)) - jnp.outer(self.Gamma @ Phi, omega)
        return RepairedState(flux, rate, U)

    def step(
        self, state: RepairedState, h: float, volt_seconds: jax.Array, row: Regressors
    ) -> RepairedState:
        n, Phi, Phi_theta = self.constants.n, row.Phi_flux, self.constants.regressor(row)
        flux = state.flux + volt_seconds + h * state.constants[:n]
        e = row.y - Phi @ flux - Phi_theta @ state.constants
        U, omega, K = sensitivity_step(self.Gamma, state.U, h, Phi, Phi_theta)
        direction = self.G @ omega
        change = flow_gain(omega @ direction, h) * direction * e
        # K corrects both the flux and U, which keeps the dynamics of η exact.
        return RepairedState(flux + K * e + U @ change, state.constants + change, U)

    def estimate(self, state: RepairedState) -> tuple[jax.Array, jax.Array]:
        return state.flux, state.constants
