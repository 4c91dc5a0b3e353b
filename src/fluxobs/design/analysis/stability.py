"""Is an adaptive law stable along this trajectory? The number that Remark 7 leaves to the reader.

The error of Proposition 2 obeys ``χ' = (G_a - Γ Ψ Ψᵀ) χ``. Along a periodic trajectory its Floquet
multipliers decide, along any other its Lyapunov exponents.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ...errors import ModelError
from ..regression import Parametrisation, Regressors
from ..regression.laws.base import positive_definite

Array = NDArray[np.float64]


class GainStudy(NamedTuple):
    """Growth of the error over the gain.

    Attributes
    ----------
    gains : (k,) ndarray
    growth : (k,) ndarray
        Largest |Floquet multiplier| over the record (periodic), else largest Lyapunov exponent
        [1/s].
    resolution : (k,) ndarray
        How much `growth` changes when every second row is left out: where that is much, the record
        is too coarse for the gain. NaN for an odd number of steps.
    stable : (k,) ndarray of bool
    """

    gains: Array
    growth: Array
    resolution: Array
    stable: NDArray[np.bool_]


def proposition_2(
    rows: Regressors, constants: Parametrisation, Gamma: Any = 1.0
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Ψ (rows, N), Γ (N, N) and G_a (N, N) of the printed adaptive observer along a record."""
    psi = constants.psi_record(rows)
    n, size = constants.n, psi.shape[1]
    G_a = jnp.zeros((size, size)).at[:n, n : 2 * n].set(jnp.eye(n))
    return psi, positive_definite("Gamma", Gamma, size), G_a


def _steps(psi: jax.Array, Gamma: jax.Array, G_a: jax.Array, h: jax.Array) -> jax.Array:
    """Transition of every step, (rows - 1, N, N): exponential of the generator in its middle.

    One regressor a step: the mean of two products would contract a second direction, which at high
    gain makes an unstable law look stable. In coordinates in which Γ is the identity, whatever the
    units of the constants are: neither multipliers nor exponents depend on them.
    """
    root = jnp.linalg.cholesky(Gamma)
    balanced = psi @ root
    moved = jax.scipy.linalg.solve_triangular(root, G_a @ root, lower=True)
    middle = (balanced[:-1] + balanced[1:]) / 2
    generator = moved - jnp.einsum("ki,kj->kij", middle, middle)
    return jnp.asarray(jax.scipy.linalg.expm(generator * h, max_squarings=48))


def _product(steps: jax.Array) -> jax.Array:
    """All steps in order of time."""

    def body(product: jax.Array, step: jax.Array) -> tuple[jax.Array, None]:
        return step @ product, None

    return jnp.asarray(jax.lax.scan(body, jnp.eye(steps.shape[1]), steps)[0])


def _logarithms(steps: jax.Array) -> jax.Array:
    """Growth of an orthonormal frame over all steps."""

    def body(q: jax.Array, step: jax.Array) -> tuple[jax.Array, jax.Array]:
        q, r = jnp.linalg.qr(step @ q)
        diagonal = jnp.abs(jnp.diag(r))
        # A direction contracted to nothing; NaN stays NaN.
        return q, jnp.log(jnp.where(diagonal == 0, np.finfo(float).tiny, diagonal))

    return jax.lax.scan(body, jnp.eye(steps.shape[1]), steps)[1].sum(axis=0)


def floquet_multipliers(steps: jax.Array) -> Array:
    """Eigenvalues of the product of all steps, the record being one period; largest first.

    Parameters
    ----------
    steps : (rows, N, N) array
        Transition matrices in order of time.
    """
    values = np.linalg.eigvals(np.asarray(_product(jnp.asarray(steps))))
    return np.asarray(values[np.argsort(-np.abs(values))])


def lyapunov_exponents(steps: jax.Array, h: float) -> Array:
    """Mean exponential growth rates [1/s] over a record of steps h apart, by QR; largest first."""
    return np.sort(np.asarray(_logarithms(jnp.asarray(steps))))[::-1] / (len(steps) * h)


@partial(jax.jit, static_argnames="periodic")
def _growth(
    psi: jax.Array, Gammas: jax.Array, G_a: jax.Array, h: jax.Array, periodic: bool
) -> jax.Array:
    """Monodromy, or logarithms of growth, for each gain."""
    grow = _product if periodic else _logarithms
    return jnp.asarray(jax.lax.map(lambda Gamma: grow(_steps(psi, Gamma, G_a, h)), Gammas))


def over_gain(
    rows: Regressors,
    constants: Parametrisation,
    h: float,
    gains: Sequence[float],
    Gamma: Any = 1.0,
    periodic: bool = True,
) -> GainStudy:
    """Stability of Proposition 2 along a record, over gains γ Γ.

    Parameters
    ----------
    rows : Regressors
        Leading axis time, h apart, fine enough for the trajectory; if `periodic`, exactly one
        period, the first row repeated at the end.
    constants : Parametrisation
    h : float
        [s].
    gains : sequence of float
        γ.
    Gamma : number, vector or matrix
        Shape of the gain.
    periodic : bool
        Floquet multipliers (True) or Lyapunov exponents.

    Raises
    ------
    ModelError
        The record is said to be periodic and its ends differ.
    """
    psi, matrix, G_a = proposition_2(rows, constants, Gamma)
    if periodic:
        gap = float(jnp.abs(psi[0] - psi[-1]).max() / jnp.abs(psi).max())
        if gap > 1e-3:
            raise ModelError(
                f"not periodic: the regressor's ends differ by {gap:.2g} of its peak; give one "
                f"period in steady state, or periodic=False"
            )
    Gammas = jnp.asarray(gains)[:, None, None] * matrix
    growth = np.full((2, len(gains)), np.nan)
    for coarse in (0, 1):
        stride = 1 + coarse
        if (len(psi) - 1) % stride == 0:
            found = np.asarray(_growth(psi[::stride], Gammas, G_a, stride * h, periodic))
            if not np.isfinite(found).all():
                raise ModelError(f"gains {list(gains)}: the transition over {h:g} s is not finite")
            if periodic:
                growth[coarse] = np.abs(np.linalg.eigvals(found)).max(axis=1)
            else:
                growth[coarse] = found.max(axis=1) / ((len(psi) - 1) * h)
    return GainStudy(
        np.asarray(gains, float),
        growth[0],
        np.abs(growth[1] - growth[0]),
        growth[0] < (1.0 if periodic else 0.0),
    )
