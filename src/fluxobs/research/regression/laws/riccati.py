"""Least squares with forgetting on the regression: a Kalman-like observer in square-root form."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ....errors import ModelError
from ....simulation.precision import real
from .. import Parametrisation, Regressors


class RiccatiState(NamedTuple):
    """Triangular R and right-hand side z of ``R x = z``, x = (λ, θ)."""

    R: jax.Array
    z: jax.Array


class RiccatiObserver(eqx.Module):
    """``x̂ = M⁻¹ m`` with ``M' = -M/T - AᵀM - M A + ΨΨᵀ``; the state holds R of ``M = RᵀR``.

    Parameters
    ----------
    memory : float
        Memory T [s].
    scale : (n + n_θ,) array_like
        Prior standard deviation of each unknown; it also scales the initial information.
    noise : float
        Standard deviation of y times the root of its bandwidth; it weighs the data against the
        prior.
    constants : Parametrisation
    """

    memory: float
    scale: jax.Array
    noise: float
    constants: Parametrisation

    def __init__(self, memory: float, scale: Any, noise: float, constants: Parametrisation) -> None:
        size = constants.n + len(constants)
        self.scale = real("scale", scale, (size,))
        for name, value in (("memory", memory), ("noise", noise)):
            if not value > 0:
                raise ModelError(f"{name} must be positive, got {value}")
        if not bool((self.scale > 0).all()):
            raise ModelError(f"scale must be positive, got {self.scale.tolist()}")
        self.memory, self.noise = float(memory), float(noise)
        self.constants = constants

    def init(self) -> RiccatiState:
        return RiccatiState(jnp.diag(1 / self.scale), jnp.zeros(len(self.scale)))

    def step(
        self, state: RiccatiState, h: float, volt_seconds: jax.Array, row: Regressors
    ) -> RiccatiState:
        n, size = self.constants.n, len(self.scale)
        back = jnp.eye(size).at[:n, n : 2 * n].add(-h * jnp.eye(n))
        R = state.R @ back
        z = state.z + R[:, :n] @ volt_seconds
        fade = jnp.exp(-h / (2 * self.memory))
        psi = self.constants.psi(row)
        weight = jnp.sqrt(h) / self.noise
        stacked = jnp.vstack(
            [
                jnp.column_stack([fade * R, fade * z]),
                weight * jnp.append(psi, row.y)[None],
            ]
        )
        factor = jnp.linalg.qr(stacked, mode="r")
        return RiccatiState(factor[:size, :size], factor[:size, size])

    def estimate(self, state: RiccatiState) -> tuple[jax.Array, jax.Array]:
        x = jax.scipy.linalg.solve_triangular(state.R, state.z)
        return x[: self.constants.n], x[self.constants.n :]
