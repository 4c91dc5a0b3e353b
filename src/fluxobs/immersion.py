"""The exact linear system in which the observer runs: readable reference of the C core.

State ``x = (s, λ, κ, θ, c)`` of length 2n + 3 with ``s = λᵀQ1λ + Eᵀλ + d``,
``κ = θᵀ(2 Q1 λ + E)`` and ``c = θᵀQ1θ``, θ being the drift: ``λ̇ = y_m + θ``. With volt-seconds
``v = ∫ y_m dt`` over one sample the transition below is exact at any sampling rate; nothing is
discretised. Derivation: docs/theory.md, section 4.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .constraint import QuadraticConstraint

Array = NDArray[np.floating]


def _slices(n: int) -> tuple[slice, slice, slice, slice, slice]:
    """Where s, λ, κ, θ and c stand."""
    s, flux, kappa = slice(0, 1), slice(1, n + 1), slice(n + 1, n + 2)
    return s, flux, kappa, slice(n + 2, 2 * n + 2), slice(2 * n + 2, 2 * n + 3)


def lift(constraint: QuadraticConstraint, flux: ArrayLike, drift: ArrayLike) -> Array:
    """State of the immersion that belongs to flux [Wb] and drift [V], each (n,)."""
    x, theta = np.asarray(flux), np.asarray(drift)
    s = x @ constraint.Q1 @ x + constraint.E @ x + constraint.d
    kappa = theta @ (2 * constraint.Q1 @ x + constraint.E)
    return np.concatenate([[s], x, [kappa], theta, [theta @ constraint.Q1 @ theta]])


def transition(constraint: QuadraticConstraint, h: float, volt_seconds: ArrayLike) -> Array:
    """F(h, v) of ``x₊ = F x + input``, unit upper triangular; ``F(h, v)⁻¹ = F(-h, -v)``.

    Parameters
    ----------
    h : float
        Sample time [s].
    volt_seconds : (n,) array_like
        ∫ (-R i_m + B u_m) dt over the sample [Wb].

    Returns
    -------
    (2n + 3, 2n + 3) ndarray
    """
    v = np.asarray(volt_seconds)
    s, flux, kappa, drift, c = _slices(constraint.n)
    q = 2 * constraint.Q1 @ v
    F = np.eye(2 * constraint.n + 3, dtype=np.result_type(v, float))
    F[s, flux], F[s, kappa], F[s, drift], F[s, c] = q, h, h * q, h * h
    F[flux, drift] = h * np.eye(constraint.n)
    F[kappa, drift], F[kappa, c] = q, 2 * h
    return F


def known_input(constraint: QuadraticConstraint, volt_seconds: ArrayLike) -> Array:
    """What v adds to the state: ``(vᵀQ1v + Eᵀv, v, 0, 0, 0)``."""
    v = np.asarray(volt_seconds)
    s, flux, *_ = _slices(constraint.n)
    out = np.zeros(2 * constraint.n + 3, dtype=np.result_type(v, float))
    out[s] = v @ constraint.Q1 @ v + constraint.E @ v
    out[flux] = v
    return out


def output_row(constraint: QuadraticConstraint, current: ArrayLike) -> tuple[Array, float]:
    """Row H and value y of the measurement ``y = H x``: the constraint at the measured current."""
    i = np.asarray(current)
    s, flux, *_ = _slices(constraint.n)
    row = np.zeros(2 * constraint.n + 3, dtype=np.result_type(i, float))
    row[s] = 1.0
    row[flux] = constraint.Q2 @ i
    return row, -(i @ constraint.Q3 @ i + constraint.C @ i)
