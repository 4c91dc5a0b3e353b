"""Methods the paper argues against: open-loop integration, alone or with an estimated start."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ....errors import ModelError
from .. import Regressors
from .base import flow_gain, positive_definite


class VoltageModel(eqx.Module):
    """``λ̂' = y_m``. The estimate keeps its initial error and drifts by θ t under bias."""

    n: int = eqx.field(static=True)

    def init(self) -> jax.Array:
        return jnp.zeros(self.n)

    def derivative(self, state: jax.Array, y_m: jax.Array, row: Regressors) -> jax.Array:
        return y_m

    def step(
        self, state: jax.Array, h: float, volt_seconds: jax.Array, row: Regressors
    ) -> jax.Array:
        return state + volt_seconds

    def estimate(self, state: jax.Array) -> tuple[jax.Array, jax.Array]:
        return state, jnp.zeros(0)


class PeboState(NamedTuple):
    """Integral ξ; information M, m of the constant λ - ξ; estimate of that constant."""

    xi: jax.Array
    M: jax.Array
    m: jax.Array
    offset: jax.Array


class PEBO(eqx.Module):
    """Parameter-estimation-based observer: estimates the constant λ - ξ, with ``ξ' = y_m``.

    With the gradient estimator and λ̂ = ξ + θ̂_0, this observer equals that of Proposition 1, but
    carries two signals that grow without bound under bias. Least squares relies on a constant λ -
    ξ, so the flux error itself grows without bound under bias.

    Parameters
    ----------
    n : int
        Number of ports.
    estimator : {"least-squares", "gradient"}
    Gamma : number, (n,) or (n, n)
        Gain of the gradient estimator; for least squares, the initial inverse information.

    References
    ----------
    R. Ortega, A. Bobtsov, A. Pyrkin, S. Aranovskiy, "A parameter estimation approach to state
    observation of nonlinear systems", Systems & Control Letters 85 (2015),
    doi:10.1016/j.sysconle.2015.09.008.
    """

    Gamma: jax.Array
    estimator: Literal["least-squares", "gradient"] = eqx.field(static=True)

    def __init__(
        self,
        n: int,
        estimator: Literal["least-squares", "gradient"] = "least-squares",
        Gamma: Any = 1.0,
    ) -> None:
        if estimator not in ("least-squares", "gradient"):
            raise ModelError(f"estimator must be least-squares or gradient, got {estimator!r}")
        self.Gamma = positive_definite("Gamma", Gamma, n)
        self.estimator = estimator

    def init(self) -> PeboState:
        n = len(self.Gamma)
        return PeboState(jnp.zeros(n), jnp.linalg.inv(self.Gamma), jnp.zeros(n), jnp.zeros(n))

    def step(
        self, state: PeboState, h: float, volt_seconds: jax.Array, row: Regressors
    ) -> PeboState:
        xi, Phi = state.xi + volt_seconds, row.Phi_flux
        y = row.y - Phi @ xi
        if self.estimator == "gradient":
            direction = self.Gamma @ Phi
            gain = flow_gain(Phi @ direction, h)
            return state._replace(
                xi=xi, offset=state.offset + gain * direction * (y - Phi @ state.offset)
            )
        M, m = state.M + h * jnp.outer(Phi, Phi), state.m + h * Phi * y
        return PeboState(xi, M, m, jnp.linalg.solve(M, m))

    def estimate(self, state: PeboState) -> tuple[jax.Array, jax.Array]:
        return state.xi + state.offset, jnp.zeros(0)
