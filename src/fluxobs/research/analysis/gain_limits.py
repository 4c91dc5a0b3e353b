"""Exponents of Proposition 2 at small and at large gain (docs/theorems.md, Theorems 3 and 4).

At small gain the error grows with the square root of the gain, because the regressor of the drift
lags behind that of the flux by the filter's group delay. At large gain the sum of the exponents
that remain finite has a closed form.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...core.arrays import Array
from ...errors import ModelError
from ..regression import Parametrisation
from ..regression.laws.base import positive_definite


def _regressor_and_gain(
    psi: ArrayLike, constants: Parametrisation, Gamma: Any
) -> tuple[Array, Array]:
    """Return (Ψ (rows, N), Γ (N, N)) after a check of their shapes."""
    regressor, size = np.asarray(psi, float), constants.n + len(constants)
    if regressor.ndim != 2 or regressor.shape[1] != size:
        raise ModelError(f"psi must be (rows, {size}), got {regressor.shape}")
    return regressor, np.asarray(positive_definite("Gamma", Gamma, size))


def small_gain_rates(psi: ArrayLike, constants: Parametrisation, Gamma: Any = 1.0) -> Array:
    """Return the n exponents of Proposition 2 for the gain γ Γ, γ → 0, over √γ [s^-1].

    They are the roots √eig(-⟨(ΓΨ)_m Φ_λᵀ⟩) with positive real part; (ΓΨ)_m are the rows of the
    drift. If Γ is block-diagonal, the real parts are positive unless the gradient of the relation
    is constant: the law is unstable.

    Parameters
    ----------
    psi : (rows, n + n_θ) array_like
        Ψ over one period, or over a long record.
    constants : Parametrisation
    Gamma : number, vector or matrix
        Shape of the gain.

    Returns
    -------
    (n,) ndarray of complex
        Largest real part first.
    """
    regressor, gain = _regressor_and_gain(psi, constants, Gamma)
    n = constants.n
    correlation = (regressor @ gain)[:, n : 2 * n].T @ regressor[:, :n] / len(regressor)
    roots = np.sqrt(np.linalg.eigvals(-correlation).astype(complex))
    return np.asarray(roots[np.argsort(-roots.real)])


def large_gain_sum(psi: ArrayLike, constants: Parametrisation, Gamma: Any = 1.0) -> float:
    """Return the sum of the exponents that stay finite for the gain γ Γ, γ → ∞ [1/s].

    It is -⟨Φ_λᵀ(ΓΨ)_m / ΨᵀΓΨ⟩; if it is positive, at least one exponent is, and the law is unstable
    at every large gain. Parameters as in :func:`small_gain_rates`; Ψ must not vanish.

    Raises
    ------
    ModelError
        If Ψ is zero in a row.
    """
    regressor, gain = _regressor_and_gain(psi, constants, Gamma)
    n = constants.n
    scaled = regressor @ gain
    size = np.einsum("ki,ki->k", regressor, scaled)
    if not (size > 0).all():
        raise ModelError(f"psi is zero in row {int(np.argmin(size))}: no limit at large gain")
    across = np.einsum("ki,ki->k", regressor[:, :n], scaled[:, n : 2 * n])
    return -float(np.mean(across / size))
