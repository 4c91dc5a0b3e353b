"""Excitation and observability as conditions on signals: the gradient of the relation.

The filters of Lemma 1 drop out of both conditions (docs/theorems.md, Theorems 1 and 2). With
n = ∇_λ w along a trajectory, (pe1) holds if no component of n is constant over a window, and flux
and drift are observable if no n·(a + b t) is constant.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...core.arrays import Array
from ...errors import ModelError
from ...machines.model.constraint import QuadraticConstraint
from .excitation import Excitation, gram

#: Windows of a certificate start a quarter of a window apart.
WINDOWS_PER_LENGTH = 4


def relation_gradients(
    relations: Sequence[QuadraticConstraint], flux: ArrayLike, current: ArrayLike
) -> tuple[Array, Array]:
    """Return (∇_λ w, ∇_i w) of every relation along a trajectory, both (rows, r, n)."""
    x, i = np.asarray(flux, float), np.asarray(current, float)
    n = relations[0].n
    if x.shape != i.shape or x.ndim != 2 or x.shape[1] != n:
        raise ModelError(f"flux and current must be (rows, {n}), got {x.shape} and {i.shape}")
    by_flux = [2 * x @ w.Q1 + i @ w.Q2.T + w.E for w in relations]
    by_current = [2 * i @ w.Q3 + x @ w.Q2 + w.C for w in relations]
    return np.stack(by_flux, axis=1), np.stack(by_current, axis=1)


def gradient_excitation(gradient: ArrayLike, h: float, window: float) -> Excitation:
    """Return the eigenvalues of ``∫ (n - n̄)(n - n̄)ᵀ`` over sliding windows, summed over relations.

    (pe1) holds for any ν if and only if the smallest eigenvalue is bounded below for some window.

    Parameters
    ----------
    gradient : (rows, n) or (rows, r, n) array_like
        ∇_λ w along the trajectory.
    h, window : float
        Sample time and window length [s].
    """
    values = np.asarray(gradient, float)
    if values.ndim == 2:
        values = values[:, None]
    total = np.zeros(())
    for relation in range(values.shape[1]):
        n = values[:, relation] - values[:, relation].mean(axis=0)
        products = gram(np.column_stack([n, np.ones(len(n))]), h, window)
        sums, duration = products[:, :-1, -1], products[:, -1, -1]
        total = (
            total + products[:, :-1, :-1] - np.einsum("ki,kj->kij", sums, sums / duration[:, None])
        )
    eigenvalues = np.linalg.eigvalsh(total)
    smallest = np.maximum(np.asarray(eigenvalues[:, 0], float), 0.0)
    return Excitation(round(window / h) * h, smallest, np.asarray(eigenvalues[:, -1], float))


@dataclass(frozen=True, eq=False)
class ObservabilityCertificate:
    """Observability of flux, drift and, if unknown, current bias over windows of one length.

    Attributes
    ----------
    window : float
        Length [s].
    smallest : (windows,) ndarray
        Smallest eigenvalue of each window's Gramian, per-unit: 1 if one direction were all that the
        relation sees; below 1e-12, it is rounding.
    invisible : ndarray of int, (windows,)
        Number of eigenvalues below `tolerance` times the largest.
    weakest : (n or 2n or 3n,) ndarray
        Direction of the smallest eigenvalue in the worst window: flux, drift, current bias, each in
        its per-unit size (flux, flux per half window, current).
    """

    window: float
    smallest: Array
    invisible: Array
    weakest: Array

    @property
    def observable(self) -> bool:
        """Whether every window determines all unknowns."""
        return not bool(self.invisible.any())


def certify_observability(
    relations: Sequence[QuadraticConstraint],
    flux: ArrayLike,
    current: ArrayLike,
    h: float,
    window: float,
    unknowns: Iterable[str] = ("drift",),
    tolerance: float = 1e-11,
) -> ObservabilityCertificate:
    """Certify on a trajectory whether flux and constants are observable, for any relations.

    To first order, a window determines (λ, θ, δ_i) if and only if no ``n·(a + b t) + m·s`` is
    constant in it, with n = ∇_λ w and m = ∇_i w of every relation. The constant of each relation is
    unknown, as in the immersion and in the regression.

    Parameters
    ----------
    relations : sequence of QuadraticConstraint
    flux, current : (rows, n) array_like
        Trajectory [Wb], [A].
    h, window : float
        Sample time and window length [s].
    unknowns : iterable of {"drift", "current-bias"}
        Unknowns in addition to the flux.
    tolerance : float
        Relative eigenvalue below which a direction counts as invisible.

    Raises
    ------
    ModelError
        If shapes do not fit, the window does not fit into the record, or an unknown has no name.
    """
    unknown = set(unknowns)
    if not unknown <= {"drift", "current-bias"}:
        raise ModelError(f'unknowns must be "drift" and "current-bias", got {sorted(unknown)}')
    by_flux, by_current = relation_gradients(relations, flux, current)
    rows, count, _ = by_flux.shape
    length = round(window / h) + 1
    if not 3 <= length <= rows:
        raise ModelError(f"a window of {window:g} s does not fit: the record has {rows} rows")
    n_unit = by_flux * _size(flux)
    scale = np.sqrt(np.mean(np.sum(n_unit**2, axis=2), axis=0))
    if not (scale > 0).all():
        raise ModelError("the gradient of a relation is zero along the whole trajectory")
    n_unit = n_unit / scale[:, None]
    m_unit = by_current * _size(current) / scale[:, None]
    time = np.linspace(-1, 1, length)[:, None, None]
    weights = np.full(length, 1.0)
    weights[[0, -1]] = 0.5  # trapezoidal rule
    weights /= weights.sum()
    constant = np.broadcast_to(-np.eye(count), (length, count, count))
    smallest, invisible, vectors = [], [], []
    for start in range(0, rows - length + 1, max(1, length // WINDOWS_PER_LENGTH)):
        part = slice(start, start + length)
        columns = [n_unit[part]]
        if "drift" in unknown:
            columns.append(time * n_unit[part])
        if "current-bias" in unknown:
            columns.append(m_unit[part])
        g = np.concatenate([*columns, constant], axis=2)
        values, directions = np.linalg.eigh(np.einsum("k,kri,krj->ij", weights, g, g))
        smallest.append(max(float(values[0]), 0.0))
        invisible.append(int((values < tolerance * values[-1]).sum()))
        vectors.append(directions[:-count, 0])
    worst = int(np.argmin(smallest))
    return ObservabilityCertificate(
        (length - 1) * h, np.array(smallest), np.array(invisible), vectors[worst]
    )


def _size(signal: ArrayLike) -> Array:
    """Return the rms of every port; a port without signal gets the size of the largest."""
    rms = np.sqrt(np.mean(np.asarray(signal, float) ** 2, axis=0))
    return np.asarray(np.where(rms > 0, rms, max(float(rms.max()), np.finfo(float).tiny)))
