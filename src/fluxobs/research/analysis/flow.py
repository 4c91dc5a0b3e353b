"""Integrate the error of a gradient law, ``x' = N x + f + ψ (r - ψᵀx)``, at any stiffness.

The laws of the paper have this form, with ψ = Ψ scaled by the root of the gain. The rates |ψ|²
reach 10⁷ 1/s and more, but the result depends only on how ψ turns. The integrator must therefore
resolve ψ but not the rates. Radau IIA with three stages does this; it has order five and is
L-stable. The generator is constant except for a term of rank one, so a step costs the solution of
only three linear equations.

References
----------
E. Hairer, G. Wanner, *Solving Ordinary Differential Equations II*, Springer, 1996, section IV.5,
doi:10.1007/978-3-642-05221-7.
"""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
from numpy.typing import ArrayLike

from ...core.arrays import Array

_ROOT = np.sqrt(6.0)
#: Nodes of a step and weights of the stages.
NODES: Array = np.array([(4 - _ROOT) / 10, (4 + _ROOT) / 10, 1.0])
_STAGES: Array = np.array(
    [
        [(88 - 7 * _ROOT) / 360, (296 - 169 * _ROOT) / 1800, (-2 + 3 * _ROOT) / 225],
        [(296 + 169 * _ROOT) / 1800, (88 + 7 * _ROOT) / 360, (-2 - 3 * _ROOT) / 225],
        [(16 - _ROOT) / 36, (16 + _ROOT) / 36, 1 / 9],
    ]
)


#: Steps per compiled call. Records of any length share one compilation.
_BLOCK = 4096


def flow_steps(
    N: ArrayLike, psi: ArrayLike, h: float, r: ArrayLike | None = None, f: ArrayLike | None = None
) -> tuple[Array, Array]:
    """Return the transition P and the input g of every step ``x₊ = P x + g``.

    Parameters
    ----------
    N : (k, k) array_like
        Constant part of the generator [1/s].
    psi : (steps, 3, k) array_like
        ψ at the :data:`NODES` of each step.
    h : float
        Step [s].
    r : (steps, 3) array_like, optional
        Residual at the nodes; default zero.
    f : (k,) array_like, optional
        Constant input; default zero.

    Returns
    -------
    P : (steps, k, k) ndarray
    g : (steps, k) ndarray
    """
    generator, psi = np.asarray(N, float), np.asarray(psi, float)
    k = len(generator)
    residual = np.zeros(psi.shape[:2]) if r is None else np.asarray(r, float)
    constant = np.zeros(k) if f is None else np.asarray(f, float)
    # Without the term of rank one, the stages are X = M (1 ⊗ x) + h MA (...).
    M = np.linalg.inv(np.eye(3 * k) - h * np.kron(_STAGES, generator))
    MA = (M @ np.kron(_STAGES, np.eye(k))).reshape(3, k, 3, k)
    start = M.reshape(3, k, 3, k).sum(axis=2)
    pushed = h * np.einsum("ikjl,l->ik", MA, constant)
    # e = r - ψᵀX at the stages.
    count = len(psi)
    W, right = np.empty((count, 3, 3)), np.empty((count, 3, k + 1))
    last = np.empty((count, k, 3))
    for j in range(3):
        moved = (psi[:, j] @ MA[:, :, j].reshape(3 * k, k).T).reshape(count, 3, k)
        W[:, :, j] = h * np.einsum("nik,nik->ni", moved, psi)
        last[:, :, j] = h * moved[:, 2]
        right[:, j, :k] = -psi[:, j] @ start[j]
        right[:, j, k] = residual[:, j] - psi[:, j] @ pushed[j]
    change = last @ np.linalg.solve(np.eye(3) + W, right)
    return start[2] + change[..., :k], pushed[2] + change[..., k]


@jax.jit
def _block(P: jax.Array, g: jax.Array, x: jax.Array) -> jax.Array:
    def body(x: jax.Array, step: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        x = step[0] @ x + step[1]
        return x, x

    return jax.lax.scan(body, x, (P, g))[1]


def flow_states(
    N: ArrayLike, psi: Array, h: float, x: Array, r: ArrayLike | None = None, f: Any = None
) -> Array:
    """Return the states (steps, k) after every step, from the state x; otherwise as `flow_steps`.

    The steps are computed in blocks that fit into the cache.
    """
    states = np.empty((len(psi), len(x)))
    for at in range(0, len(psi), _BLOCK):
        part = slice(at, at + _BLOCK)
        P, g = flow_steps(N, psi[part], h, None if r is None else np.asarray(r)[part], f)
        count = len(g)
        if count < _BLOCK:
            P = np.concatenate([P, np.zeros((_BLOCK - count, *P.shape[1:]))])
            g = np.concatenate([g, np.zeros((_BLOCK - count, g.shape[1]))])
        states[part] = np.asarray(_block(P, g, x))[:count]
        x = states[at + count - 1]
    return states


def flow_product(P: Array) -> Array:
    """Return the product (k, k) of all steps in order of time."""
    while len(P) > 1:
        odd = P[-1:] if len(P) % 2 else P[:0]
        P = np.concatenate([P[1::2] @ P[: len(P) - len(odd) : 2], odd])
    return np.asarray(P[0])


def flow_joined(P: Array, times: int) -> Array:
    """Return the products of 2^times steps each; drop an incomplete last product."""
    for _ in range(times):
        P = P[1::2] @ P[: 2 * (len(P) // 2) : 2]
    return P


def flow_growth(P: Array) -> Array:
    """Return the logarithmic growth (steps,) of a vector in every step."""
    x = np.full(P.shape[1], P.shape[1] ** -0.5)
    growth = np.empty(len(P))
    for k, step in enumerate(P):
        x = step @ x
        size = np.sqrt(x @ x)
        growth[k] = np.log(size)
        x /= size
    return growth
