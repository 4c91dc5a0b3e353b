"""Generalised PEBO writes the state as a known signal plus a known matrix times a constant."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, get_args

import equinox as eqx
import jax
import jax.numpy as jnp

from ....errors import ModelError
from ....simulation.precision import not_negative, positive, real
from .. import Parametrisation, Regressors
from .base import flow_gain

Estimator = Literal["least-squares", "least-squares-drem"]


class GpeboState(NamedTuple):
    """Integral ξ, time t, per-unit information M and m, start's weight in them, mixed estimate."""

    xi: jax.Array
    t: jax.Array
    M: jax.Array
    m: jax.Array
    start_weight: jax.Array
    mixed: jax.Array


class GeneralisedPEBO(eqx.Module):
    """Estimate the constant ϑ of ``x(t) = (ξ, 0) + Φ_A(t) ϑ``, with ξ' = y_m and x = (λ, θ, …).

    ``Φ_A(t)`` adds t θ to the flux. The drift is then part of ϑ = (λ(0) - ξ(0), θ, …), so bias no
    longer breaks the method, but ξ and t grow without bound. ϑ is estimated from
    ``y - Φ_λᵀ ξ = ΨᵀΦ_A(t) ϑ``

    * by least squares, with or without forgetting: ``F⁻¹' = φφᵀ - β (1 - ‖F‖/‖F(0)‖) F⁻¹``; or
    * by least squares with a mixing step. The influence of the initial guess is known exactly:
      ``(I - z F F(0)⁻¹) ϑ = ϑ̂ - z F F(0)⁻¹ ϑ̂(0)``, z' = -β (1 - …) z. This equation gives scalar
      regressions ``Δ ϑ_j = Y_j``, and a gradient law for each. Excitation over one interval is
      sufficient.

    Parameters
    ----------
    constants : Parametrisation
    scale : (n + n_θ,) array_like
        Prior standard deviation of each unknown, also used as its unit.
    noise : float
        Standard deviation of y times the root of its bandwidth.
    estimator : {"least-squares", "least-squares-drem"}
    forgetting : float
        β [1/s]; 0 means no forgetting.
    gamma : float
        Gain of the scalar gradients [1/s]; they converge at γ Δ².

    References
    ----------
    R. Ortega, A. Bobtsov, N. Nikolaev, J. Schiffer, D. Dochain, "Generalized parameter
    estimation-based observers: Application to power systems and chemical-biological reactors",
    Automatica 129 (2021), doi:10.1016/j.automatica.2021.109635. R. Ortega, J. G. Romero,
    S. Aranovskiy, "A new least squares parameter estimator for nonlinear regression equations with
    relaxed excitation conditions and forgetting factor", doi:10.48550/arXiv.2205.00099.
    """

    constants: Parametrisation
    scale: jax.Array
    noise: jax.Array
    estimator: Estimator = eqx.field(static=True)
    forgetting: jax.Array
    gamma: jax.Array

    def __init__(
        self,
        constants: Parametrisation,
        scale: Any,
        noise: Any,
        estimator: Estimator = "least-squares",
        forgetting: Any = 0.0,
        gamma: Any = 1.0,
    ) -> None:
        if estimator not in get_args(Estimator):
            raise ModelError(
                f"estimator must be one of {', '.join(get_args(Estimator))}, got {estimator!r}"
            )
        self.constants, self.estimator = constants, estimator
        self.scale = positive("scale", real("scale", scale), (constants.n + len(constants),))
        self.noise = positive("noise", noise)
        self.forgetting = not_negative("forgetting", forgetting)
        self.gamma = positive("gamma", gamma)

    def init(self) -> GpeboState:
        size, zero = len(self.scale), jnp.zeros(())
        return GpeboState(
            jnp.zeros(self.constants.n),
            zero,
            jnp.eye(size),
            jnp.zeros(size),
            jnp.ones(()),
            jnp.zeros(size),
        )

    def _moved(self, x: jax.Array, t: jax.Array) -> jax.Array:
        """Return Φ_A(t)ᵀ x."""
        n = self.constants.n
        return x.at[n : 2 * n].add(t * x[:n])

    def step(
        self, state: GpeboState, h: float, volt_seconds: jax.Array, row: Regressors
    ) -> GpeboState:
        xi, t = state.xi + volt_seconds, state.t + h
        phi = self._moved(self.constants.psi(row), t) * self.scale
        y = row.y - row.Phi_flux @ xi
        # F <= I: without excitation, forgetting ends before the estimate is worse than at first.
        uncertainty = jnp.minimum(1 / jnp.linalg.eigvalsh(state.M)[0], 1.0)
        fade = jnp.exp(-self.forgetting * (1 - uncertainty) * h)
        weight = h / self.noise**2
        M = fade * state.M + weight * jnp.outer(phi, phi)
        m, start_weight = fade * state.m + weight * phi * y, fade * state.start_weight
        mixed = state.mixed
        if self.estimator == "least-squares-drem":
            # I - z F F(0)⁻¹ with F(0) = I; the initial value of the estimate is zero.
            share = jnp.eye(len(m)) - start_weight * jnp.linalg.inv(M)
            delta = jnp.linalg.det(share)
            solution = jnp.linalg.solve(M, m)
            # Cramer's rule: Y_j is the determinant of `share` with the estimate in column j.
            Y = jax.vmap(lambda j: jnp.linalg.det(share.at[:, j].set(solution)))(jnp.arange(len(m)))
            gain = flow_gain(self.gamma * delta**2, h)
            mixed = mixed + gain * self.gamma * delta * (Y - delta * mixed)
        return GpeboState(xi, t, M, m, start_weight, mixed)

    def estimate(self, state: GpeboState) -> tuple[jax.Array, jax.Array]:
        n = self.constants.n
        mixing = self.estimator == "least-squares-drem"
        theta = self.scale * (state.mixed if mixing else jnp.linalg.solve(state.M, state.m))
        return state.xi + theta[:n] + state.t * theta[n : 2 * n], theta[n:]
