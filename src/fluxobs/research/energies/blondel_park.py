"""Blondel-Park transformability: whether a rotation removes the position from the energy.

The paper asks how this property relates to Assumption 1. A machine is transformable if each
coordinate q_k has a constant skew U_k with ``H_E(λ, q) = H_0(e^{-U q} λ) + V(q)``. For linear
magnetics, transformability means ``L′(q) = U L(q) - L(q) U`` and ``μ′(q) = U μ(q)``. For any
energy, the derivative with respect to q_k gives::

    ∂i/∂q_k + (∂i/∂λ) U_k λ - U_k i = 0        for all (λ, q)

This identity is linear in U_k. Transformability and Assumption 1 do not imply each other; see the
table in docs/constraints.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import numpy as np

from ...core.arrays import Array
from .system import ElectromechanicalSystem


@dataclass(frozen=True, eq=False)
class BlondelPark:
    """Result of :func:`blondel_park`.

    Attributes
    ----------
    transformable : bool
        Whether a constant skew U exists for every coordinate.
    U : (n_M, n_E, n_E) ndarray
        Best-fitting skew matrices [1/rad or 1/m].
    residual : (n_M,) ndarray
        Rms of the identity over the rms of ``∂i/∂q_k``; about 1e-15 if the identity holds,
        otherwise 0.1 … 1.
    """

    transformable: bool
    U: Array
    residual: Array


def blondel_park(
    system: ElectromechanicalSystem, samples: int = 300, tolerance: float = 1e-8, seed: int = 0
) -> BlondelPark:
    """Fit U by linear least squares over random states."""
    n, m = system.n_E, system.n_M
    rng = np.random.default_rng(seed)
    flux, position = system.random_states(rng, samples)
    i = np.asarray(jax.vmap(system.current)(flux, position))
    by_flux = np.asarray(jax.vmap(jax.jacfwd(system.current, 0))(flux, position))
    by_position = np.asarray(jax.vmap(jax.jacfwd(system.current, 1))(flux, position))
    # Balance ports of different size by the rms of their currents; that of ∂i/∂q may be zero. Weigh
    # rows, not columns: a skew U stays skew only under a common scale.
    size = np.sqrt(np.mean(i**2, axis=0))
    weight = 1 / np.maximum(size, max(1e-9 * size.max(), 1e-300))
    pairs = [(a, b) for a in range(n) for b in range(a + 1, n)]
    columns = []
    for a, b in pairs:
        U = np.zeros((n, n))
        U[a, b], U[b, a] = 1.0, -1.0
        change = np.einsum("kij,kj->ki", by_flux, np.asarray(flux) @ U.T) - i @ U.T
        columns.append((weight * change).ravel())
    A = np.array(columns).T if pairs else np.zeros((samples * n, 0))
    matrices, residual = np.zeros((m, n, n)), np.zeros(m)
    for k in range(m):
        right = -(weight * by_position[:, :, k]).ravel()
        size = np.sqrt(np.mean(right**2))
        if size == 0:
            continue
        solution = np.linalg.lstsq(A, right, rcond=None)[0] if pairs else np.zeros(0)
        rest = right - (A @ solution if pairs else 0)
        residual[k] = np.sqrt(np.mean(rest**2)) / size
        for (a, b), value in zip(pairs, solution, strict=True):
            matrices[k, a, b], matrices[k, b, a] = value, -value
    return BlondelPark(bool((residual < tolerance).all()), matrices, residual)
