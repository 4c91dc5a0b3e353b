"""Fit a table of splines to measured or computed points of a flux map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...core.arrays import Array
from ...errors import ModelError
from .flux_map import DEGREE, TableMap, basis

#: Intervals of a table in each direction; this table has 6 KB in single precision.
INTERVALS = 24
#: Candidate weights of the mean squared second derivative relative to the mean squared error.
#: Generalized cross-validation chooses one weight (Craven and Wahba 1979, doi:10.1007/BF01404567),
#: so that a table follows computed maps exactly and averages the noise of measured maps.
SMOOTHNESS = np.logspace(-12, -3, 19)
#: Largest difference of ∂ψ_d/∂i_q and ∂ψ_q/∂i_d in a good map, as a share of the mean inductance.
RECIPROCITY = 0.05


@dataclass(frozen=True, eq=False)
class FittedTable:
    """A table and the quality of its fit.

    Attributes
    ----------
    table : TableMap
    residual : float
        Root mean square of the fit's residuals [Wb].
    reciprocity : float
        Root mean square of ∂ψ_d/∂i_q - ∂ψ_q/∂i_d at the points, divided by the mean inductance; 0
        for a machine without losses.
    """

    table: TableMap
    residual: float
    reciprocity: float


def add_mirror_images(
    current: NDArray[np.complex128], flux: NDArray[np.complex128], magnets: bool
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Add the mirror images of points that cover only one sign of i_q or, without magnets, of i_d.

    ψ_d is even and ψ_q odd in i_q; without magnets ψ_d is odd and ψ_q even in i_d.
    """
    small = 1e-6 * np.abs(current).max()
    if current.imag.min() >= -small or current.imag.max() <= small:
        current, flux = np.r_[current, current.conj()], np.r_[flux, flux.conj()]
    if not magnets and (current.real.min() >= -small or current.real.max() <= small):
        current, flux = np.r_[current, -current.conj()], np.r_[flux, -flux.conj()]
    return current, flux


def fit_table(
    current: ArrayLike, flux: ArrayLike, magnets: bool, intervals: int = INTERVALS
) -> FittedTable:
    """Fit a table to points, on a grid or scattered.

    Parameters
    ----------
    current, flux : (points,) array_like
        d + j q [A], [Wb].
    magnets : bool
        Whether the machine has magnets.
    intervals : int
        Largest number of intervals per direction.

    Raises
    ------
    ModelError
        A point is not finite, the points do not span a range, or the map is implausible.
    """
    i, psi = np.asarray(current, complex).ravel(), np.asarray(flux, complex).ravel()
    if i.shape != psi.shape:
        raise ModelError(f"current and flux must have the same size, got {i.size} and {psi.size}")
    bad = ~(np.isfinite(i) & np.isfinite(psi))
    if bad.any():
        raise ModelError(f"point {int(np.argmax(bad)) + 1} of the map is not finite")
    i, psi = add_mirror_images(i, psi, magnets)
    spans = [np.array([axis.min(), axis.max()]) for axis in (i.real, i.imag)]
    for span, name in zip(spans, ("i_d", "i_q"), strict=True):
        if not span[1] > span[0]:
            raise ModelError(f"all points of the map have the same {name} ({span[0]:g} A)")
    counts = [min(intervals, 4 * _count_levels(axis)) for axis in (i.real, i.imag)]
    along_d, along_q = basis(i.real, spans[0], counts[0]), basis(i.imag, spans[1], counts[1])
    design = (along_d[:, :, None] * along_q[:, None, :]).reshape(i.size, -1)
    target = np.stack([psi.real, psi.imag], -1)
    c = _fit_smoothly(design, target, _roughness(counts))
    residuals = design @ c - target
    table = TableMap(
        spans[0],
        spans[1],
        c.reshape(counts[0] + DEGREE, counts[1] + DEGREE, 2),
        magnets=magnets,
    )
    mapped = table.at(i)
    L_d, L_q = float(np.mean(mapped.by_d.real)), float(np.mean(mapped.by_q.imag))
    for L, name in ((L_d, "d"), (L_q, "q")):
        if not L > 0:
            raise ModelError(
                f"psi_{name} falls with i_{name} in the map: currents must be positive into the "
                f"machine, and d must point along {'the magnets' if magnets else 'high permeance'}"
            )
    asymmetry = float(
        np.sqrt(np.mean((mapped.by_q.real - mapped.by_d.imag) ** 2)) / ((L_d + L_q) / 2)
    )
    return FittedTable(table, float(np.sqrt(np.mean(residuals**2))), asymmetry)


def _fit_smoothly(design: Array, target: Array, roughness: Array) -> Array:
    """Solve penalized least squares; cross-validation chooses the weight of the penalty."""
    points, splines = design.shape
    gram = design.T @ design / points
    # Without points in the corners, some splines are undetermined: a small multiple of the identity
    # keeps the problem regular.
    scale = np.trace(gram) / splines
    root = np.linalg.cholesky(gram + SMOOTHNESS[0] * scale * (roughness + np.eye(splines)))
    penalty = np.linalg.solve(root, np.linalg.solve(root, roughness).T)
    eigenvalues, vectors = np.linalg.eigh((penalty + penalty.T) / 2)
    back = np.linalg.solve(root.T, vectors)
    components = back.T @ (design.T @ target) / points
    best, best_score = components, np.inf
    for weight in SMOOTHNESS * scale:
        shrinkage = 1 / (1 + weight * np.maximum(eigenvalues, 0))
        candidate = back @ (shrinkage[:, None] * components)
        freedom = points - shrinkage.sum()
        score = np.sum((design @ candidate - target) ** 2) / freedom**2 if freedom > 0 else np.inf
        if score < best_score:
            best, best_score = candidate, score
    return np.asarray(best)


def _count_levels(values: Array) -> int:
    """Return the number of different values, up to rounding."""
    return len(np.unique(np.round(values / np.ptp(values), 6)))


def _roughness(counts: list[int]) -> Array:
    """Return the mean square of the second derivatives as a quadratic form of the coefficients.

    Both spans are scaled to 1.
    """
    axes = []
    for count in counts:
        x = np.linspace(0, 1, 4 * count + 1)
        axes.append([basis(x, np.array([0.0, 1.0]), count, n) for n in (0, 1, 2)])
    gram = [[b.T @ b / len(b) for b in bases] for bases in axes]
    (d0, d1, d2), (q0, q1, q2) = gram
    return np.asarray(np.kron(d2, q0) + 2 * np.kron(d1, q1) + np.kron(d0, q2))
