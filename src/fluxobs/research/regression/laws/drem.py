"""Dynamic regressor extension and mixing, with the finite-time formula."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ....errors import ModelError
from ....simulation.precision import real
from .. import Parametrisation, Regressors
from .base import flow_gain


class DremState(NamedTuple):
    """Extension M, m (per-unit); estimate x and open-loop estimate; w, the weight of the start."""

    M: jax.Array
    m: jax.Array
    x: jax.Array
    open_loop: jax.Array
    start_weight: jax.Array


class DremObserver(eqx.Module):
    """Extend one regression to N regressions for N unknowns, then mix them into scalar regressions.

    Kreisselmeier's extension, moved along with the flux, is ``M' = -M/T - AᵀM - M A + ΨΨᵀ``; with a
    similar equation for m, it gives ``M x = m``. Mixing with the adjugate gives ``Δ x_j = Y_j``
    with Δ = det M. Each unknown then has a scalar gradient law ``x̂_j' = … + γ Δ (Y_j - Δ x̂_j)``.
    The error is ``x̃(t) = w(t) x̃_open-loop(t)`` with ``w = exp(-γ ∫ Δ²)``. Solving this equation
    for x gives an estimate in finite time, which is used when 1 - w > `finite`.

    Parameters
    ----------
    gamma : float
        Gain [1/s]; the rate of convergence is γ Δ².
    memory : float
        T of the extension [s].
    basis : (N,) or (N, N) array_like
        Scaling ``x = basis x_pu``: sizes, or a matrix that balances the unknowns
        (:func:`fluxobs.research.analysis.balanced_basis`). Balance matters because Δ is a product
        of N eigenvalues.
    constants : Parametrisation
    finite : float
        The finite-time formula is used while 1 - w is above this value; in (0, 1].

    References
    ----------
    S. Aranovskiy, A. Bobtsov, R. Ortega, A. Pyrkin, "Performance enhancement of parameter
    estimators via dynamic regressor extension and mixing", IEEE Trans. Automatic Control 62
    (2017), doi:10.1109/TAC.2016.2614889. Finite time: R. Ortega, A. Bobtsov, N. Nikolaev,
    J. Schiffer, D. Dochain, Automatica 129 (2021), doi:10.1016/j.automatica.2021.109635.
    """

    gamma: float
    memory: float
    basis: jax.Array
    constants: Parametrisation
    finite: float

    def __init__(
        self,
        gamma: float,
        memory: float,
        basis: Any,
        constants: Parametrisation,
        finite: float = 0.1,
    ) -> None:
        size = constants.n + len(constants)
        scaling = real("basis", basis)
        self.basis = jnp.diag(scaling) if scaling.ndim == 1 else scaling
        if self.basis.shape != (size, size):
            raise ModelError(f"basis must be ({size},) or ({size}, {size}), got {scaling.shape}")
        for name, value in (("gamma", gamma), ("memory", memory)):
            if not value > 0:
                raise ModelError(f"{name} must be positive, got {value}")
        if not 0 < finite <= 1:
            raise ModelError(f"finite must lie in (0, 1], got {finite}")
        self.gamma, self.memory = float(gamma), float(memory)
        self.constants, self.finite = constants, float(finite)

    def init(self) -> DremState:
        size = len(self.basis)
        zero = jnp.zeros(size)
        return DremState(jnp.zeros((size, size)), zero, zero, zero, jnp.ones(()))

    def step(
        self, state: DremState, h: float, volt_seconds: jax.Array, row: Regressors
    ) -> DremState:
        n, size = self.constants.n, len(self.basis)
        # Per-unit: x = basis x_pu.
        plain = jnp.zeros((size, size)).at[:n, n : 2 * n].set(h * jnp.eye(n))
        drift = jnp.linalg.solve(self.basis, plain @ self.basis)
        moved = jnp.linalg.solve(self.basis, jnp.zeros(size).at[:n].set(volt_seconds))
        back = jnp.eye(size) - drift
        fade = jnp.exp(-h / self.memory)
        M = fade * back.T @ state.M @ back
        m = fade * back.T @ state.m + M @ moved
        psi = self.constants.psi(row) @ self.basis
        weight = h / self.memory
        M = M + weight * jnp.outer(psi, psi)
        m = m + weight * psi * row.y
        # Cramer's rule: Y_j is the determinant of M with m in column j.
        delta = jnp.linalg.det(M)
        Y = jax.vmap(lambda j: jnp.linalg.det(M.at[:, j].set(m)))(jnp.arange(size))
        x = state.x + drift @ state.x + moved
        open_loop = state.open_loop + drift @ state.open_loop + moved
        rate = self.gamma * delta**2
        x = x + self.gamma * delta * flow_gain(rate, h) * (Y - delta * x)
        return DremState(M, m, x, open_loop, state.start_weight * jnp.exp(-rate * h))

    def estimate(self, state: DremState) -> tuple[jax.Array, jax.Array]:
        done = 1 - state.start_weight
        safe = jnp.where(done >= self.finite, done, 1.0)
        finite_time = (state.x - state.start_weight * state.open_loop) / safe
        x = self.basis @ jnp.where(done >= self.finite, finite_time, state.x)
        return x[: self.constants.n], x[self.constants.n :]
