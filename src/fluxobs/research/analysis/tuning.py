"""Compute balanced gains from a record, with which all directions converge equally fast.

A gradient observer converges as slowly as its least excited direction. With the inverse of the
regressor's mean square as gain, all directions converge equally fast. Only the excitation in the
record matters; the record need not contain any bias.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from ...core.arrays import Array
from ...errors import ModelError
from ..regression import Parametrisation, Regressors
from ..regression.laws.gradient import RepairedAdaptiveObserver, sensitivity_step

#: Least excitation of a direction relative to the strongest; it limits the gain of weak directions.
MIN_EXCITATION = 1e-10


def balanced_gain(regressor: ArrayLike, rate: float) -> Array:
    """Return ``rate · (mean Φ Φᵀ)⁻¹``; every direction then converges at about `rate` [1/s]."""
    phi = np.asarray(regressor, float)
    size = np.sqrt(np.mean(phi**2, axis=0))
    if not (size > 0).all():
        raise ModelError(f"column {int(np.argmin(size))} of the regressor is never excited")
    values, vectors = np.linalg.eigh((phi / size).T @ (phi / size) / len(phi))
    values = np.maximum(values, MIN_EXCITATION * values[-1])
    inverse = vectors / values @ vectors.T / np.outer(size, size)
    return np.asarray(rate * (inverse + inverse.T) / 2)


def balanced_basis(gramian: ArrayLike, window: float) -> Array:
    """Return the basis in which ``gramian/window`` is the identity and therefore DREM has Δ ≈ 1."""
    W = np.asarray(gramian, float) / window
    size = 1 / np.sqrt(np.diag(W))
    root = np.linalg.cholesky(size[:, None] * W * size)
    return np.asarray(size[:, None] * np.linalg.inv(root).T)


@eqx.filter_jit
def _omega(Gamma: jax.Array, rows: Regressors, constants: Parametrisation, h: float) -> jax.Array:
    def body(U: jax.Array, row: Regressors) -> tuple[jax.Array, jax.Array]:
        Phi_theta = constants.regressor(row)
        U, omega, _ = sensitivity_step(Gamma, U, h, row.Phi_flux, Phi_theta)
        return U, omega

    _, omega = jax.lax.scan(body, jnp.zeros((constants.n, len(constants))), rows)
    return omega


def balanced_repaired(
    rows: Regressors,
    constants: Parametrisation,
    h: float,
    flux_rate: float,
    constants_rate: float,
    skip: int,
) -> RepairedAdaptiveObserver:
    """Return the repaired observer with balanced Γ and G; omit `skip` rows of transient."""
    Gamma: Any = balanced_gain(np.asarray(rows.Phi_flux)[skip:], flux_rate)
    omega = _omega(jnp.asarray(Gamma), rows, constants, h)
    G = balanced_gain(np.asarray(omega)[skip:], constants_rate)
    return RepairedAdaptiveObserver(Gamma, G, constants)
