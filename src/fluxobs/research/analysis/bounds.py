"""The bound of Proposition 1, corrected (docs/errata.md, 7)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...core.arrays import Array
from ..regression import Parametrisation, Regressors
from ..regression.laws.base import positive_definite
from .excitation import excitation


def decay_rate(Gamma: ArrayLike, window: float, alpha: float, Phi_max: float) -> float:
    """Return the paper's decay rate η [1/s] for ``∫_T Φ Φᵀ ≥ α I`` (pe1) and |Φ| ≤ Phi_max."""
    values = np.linalg.eigvalsh(np.atleast_2d(np.asarray(Gamma, float)))
    smallest, largest = values[0], values[-1]
    share = smallest * alpha / (1 + largest**2 * window**2 * Phi_max**4)
    return float(-np.log1p(-share) / (2 * window))


def robust_bound(
    Gamma: ArrayLike,
    window: float,
    alpha: float,
    Phi_max: float,
    initial_error: float,
    disturbance: float,
    t: ArrayLike,
) -> Array:
    """Return ``√κ e^{ηT} (e^{-ηt} |λ̃(0)| + (1 - e^{-ηt}) ‖b‖/η) ≥ |λ̃(t)|``, κ = λ_max/λ_min of Γ.

    Parameters
    ----------
    Gamma : (n, n) array_like
    window, alpha, Phi_max : float
        T [s] and α of (pe1); upper bound of |Φ_λ|.
    initial_error, disturbance : float
        |λ̃(0)| [Wb], ‖b‖ [V].
    t : (rows,) array_like
        Times [s].

    Returns
    -------
    (rows,) ndarray
        Bound [Wb]; inf without excitation (α = 0).
    """
    values = np.linalg.eigvalsh(np.atleast_2d(np.asarray(Gamma, float)))
    eta = decay_rate(Gamma, window, alpha, Phi_max)
    t = np.asarray(t, float)
    if not eta > 0:
        return np.full(t.shape, np.inf)
    front = np.sqrt(values[-1] / values[0]) * np.exp(eta * window)
    fade = np.exp(-eta * t)
    return np.asarray(front * (fade * initial_error + (1 - fade) * disturbance / eta))


#: Directions of the error in which :func:`peak_gain` looks, over half a turn.
DIRECTIONS = 48


def peak_gain(Phi: ArrayLike, Gamma: ArrayLike, h: float, ends: ArrayLike, lags: int) -> float:
    """Return the largest |λ̃| that a disturbance of |b| ≤ 1 V causes along a record [Wb/V].

    The error λ̃' = -ΓΦΦᵀλ̃ + b has at the time t, in the direction v, at most ∫ |F(t, s)ᵀ v| ds,
    with the transition F from s to t; b(s) along F(t, s)ᵀ v attains it. So the bound is tight: no
    smaller one holds for all such b.

    Parameters
    ----------
    Phi : (rows, 2) array_like
        Regressor, constant over an interval.
    Gamma : (2, 2) array_like
    h : float
        Interval [s].
    ends : (ends,) array_like of int
        Rows at which the error is looked at, each at least `lags`.
    lags : int
        Intervals after which a disturbance is forgotten.
    """
    Phi, Gamma = np.asarray(Phi, float), np.asarray(Gamma, float)
    q = np.einsum("ki,ij,kj->k", Phi, Gamma, Phi)
    share = np.where(q * h > 1e-12, -np.expm1(-q * h) / np.where(q > 0, q, 1.0), h)
    steps = np.eye(2) - np.einsum("k,ij,kj,kl->kil", share, Gamma, Phi, Phi)
    at = np.asarray(ends, int)
    angles = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    carried = np.broadcast_to(np.stack([np.cos(angles), np.sin(angles)]), (len(at), 2, DIRECTIONS))
    total = np.zeros((len(at), DIRECTIONS))
    for lag in range(lags):
        before = np.linalg.norm(carried, axis=1)
        carried = np.swapaxes(steps[at - lag - 1], 1, 2) @ carried
        total += h / 2 * (before + np.linalg.norm(carried, axis=1))
    return float(total.max())


def disturbance(
    rows: Regressors, constants: Parametrisation, Gamma: Any, drift: Any, current_bias: Any
) -> Array:
    """Return ``b = -(θ - Γ Φ_λ Φ_θᵀ θ_all)`` (rows, n) [V] along a record; the paper has a plus."""
    matrix = np.asarray(positive_definite("Gamma", Gamma, constants.n))
    theta = np.asarray(constants.constants(drift, current_bias))
    Phi_theta = np.asarray(constants.record(rows))
    correction = np.asarray(rows.Phi_flux) @ matrix.T * (Phi_theta @ theta)[:, None]
    return np.asarray(correction - theta[: constants.n])


def bound_on_record(
    rows: Regressors,
    constants: Parametrisation,
    Gamma: Any,
    h: float,
    window: float,
    initial_error: float,
    drift: Any,
    current_bias: Any,
    t: ArrayLike | None = None,
) -> Array:
    """Return the bound [Wb] with constants computed from a record, at its rows or at times t.

    ``t = inf`` gives the steady state.
    """
    excited = excitation(np.asarray(rows.Phi_flux), h, window)
    size = np.linalg.norm(np.asarray(rows.Phi_flux), axis=1).max()
    b = np.linalg.norm(disturbance(rows, constants, Gamma, drift, current_bias), axis=1).max()
    matrix = np.asarray(positive_definite("Gamma", Gamma, constants.n))
    times = h * np.arange(len(rows.y)) if t is None else t
    return robust_bound(
        matrix, excited.window, excited.alpha, float(size), initial_error, float(b), times
    )
