"""A table of splines from measured or computed points of a flux map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...core.arrays import Array
from ...errors import ModelError
from .flux_map import DEGREE, TableMap, basis

#: Intervals of a table in each direction: 6 KB in single precision.
INTERVALS = 24
#: Weights of the mean squared second derivatives against the mean squared errors to choose from, by
#: generalized cross-validation (Craven and Wahba 1979, doi:10.1007/BF01404567): computed maps are
#: met exactly, the noise of measured ones is averaged.
SMOOTHNESS = np.logspace(-12, -3, 19)
#: Share by which ∂ψ_d/∂i_q and ∂ψ_q/∂i_d may differ, of the mean inductance, in a good map.
RECIPROCITY = 0.05


@dataclass(frozen=True, eq=False)
class FittedTable:
    """A table and how well it fits.

    Attributes
    ----------
    table : TableMap
    residual : float
        Root mean square of what the splines leave of the points [Wb].
    reciprocity : float
        Root mean square of ∂ψ_d/∂i_q - ∂ψ_q/∂i_d over the mean inductance, among the points: a
        machine without losses has 0.
    """

    table: TableMap
    residual: float
    reciprocity: float


def mirrored(
    current: NDArray[np.complex128], flux: NDArray[np.complex128], magnets: bool
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """The points, and their mirror images where they cover one sign of i_q (without magnets: of
    i_d) only: ψ_d is even and ψ_q odd in i_q, and without magnets the other way round in i_d."""
    small = 1e-6 * np.abs(current).max()
    if current.imag.min() >= -small or current.imag.max() <= small:
        current, flux = np.r_[current, current.conj()], np.r_[flux, flux.conj()]
    if not magnets and (current.real.min() >= -small or current.real.max() <= small):
        current, flux = np.r_[current, -current.conj()], np.r_[flux, -flux.conj()]
    return current, flux


def fit_table(
    current: ArrayLike, flux: ArrayLike, magnets: bool, intervals: int = INTERVALS
) -> FittedTable:
    """Fit a table to points on a grid or scattered.

    Parameters
    ----------
    current, flux : (points,) array_like
        d + j q [A], [Wb].
    magnets : bool
        Whether there are magnets.
    intervals : int
        In each direction.

    Raises
    ------
    ModelError
        Too few points, or points that no machine has; the message says which.
    """
    i, psi = np.asarray(current, complex).ravel(), np.asarray(flux, complex).ravel()
    if i.shape != psi.shape:
        raise ModelError(f"as many currents as fluxes, got {i.size} and {psi.size}")
    bad = ~(np.isfinite(i) & np.isfinite(psi))
    if bad.any():
        raise ModelError(f"point {int(np.argmax(bad)) + 1} of the map is not finite")
    i, psi = mirrored(i, psi, magnets)
    spans = [np.array([part.min(), part.max()]) for part in (i.real, i.imag)]
    for span, name in zip(spans, ("i_d", "i_q"), strict=True):
        if not span[1] > span[0]:
            raise ModelError(f"all points of the map have the same {name} ({span[0]:g} A)")
    counts = [min(intervals, 4 * _levels(part)) for part in (i.real, i.imag)]
    along_d, along_q = basis(i.real, spans[0], counts[0]), basis(i.imag, spans[1], counts[1])
    rows = (along_d[:, :, None] * along_q[:, None, :]).reshape(i.size, -1)
    target = np.stack([psi.real, psi.imag], -1)
    c = _smoothed(rows, target, _roughness(counts))
    left = rows @ c - target
    table = TableMap(
        spans[0],
        spans[1],
        c.reshape(counts[0] + DEGREE, counts[1] + DEGREE, 2),
        magnets=magnets,
    )
    at = table.at(i)
    L_d, L_q = float(np.mean(at.by_d.real)), float(np.mean(at.by_q.imag))
    for L, name in ((L_d, "d"), (L_q, "q")):
        if not L > 0:
            raise ModelError(
                f"psi_{name} falls with i_{name} in the map: currents are positive into the "
                f"machine, d points along {'the magnets' if magnets else 'high permeance'}"
            )
    odd = float(np.sqrt(np.mean((at.by_q.real - at.by_d.imag) ** 2)) / ((L_d + L_q) / 2))
    return FittedTable(table, float(np.sqrt(np.mean(left**2))), odd)


def _smoothed(rows: Array, target: Array, roughness: Array) -> Array:
    """Penalized least squares with the weight that cross-validation prefers."""
    points, splines = rows.shape
    gram = rows.T @ rows / points
    # Corners without points are in no row: a little of the identity keeps the problem regular.
    scale = np.trace(gram) / splines
    root = np.linalg.cholesky(gram + SMOOTHNESS[0] * scale * (roughness + np.eye(splines)))
    bent = np.linalg.solve(root, np.linalg.solve(root, roughness).T)
    weights, vectors = np.linalg.eigh((bent + bent.T) / 2)
    back = np.linalg.solve(root.T, vectors)
    along = back.T @ (rows.T @ target) / points
    best, least = along, np.inf
    for weight in SMOOTHNESS * scale:
        kept = 1 / (1 + weight * np.maximum(weights, 0))
        found = back @ (kept[:, None] * along)
        free = points - kept.sum()
        score = np.sum((rows @ found - target) ** 2) / free**2 if free > 0 else np.inf
        if score < least:
            best, least = found, score
    return np.asarray(best)


def _levels(values: Array) -> int:
    """How many different values there are, up to rounding."""
    return len(np.unique(np.round(values / np.ptp(values), 6)))


def _roughness(counts: list[int]) -> Array:
    """Mean square of the second derivatives as a quadratic form of the coefficients, with both
    spans taken as 1."""
    parts = []
    for count in counts:
        at = np.linspace(0, 1, 4 * count + 1)
        parts.append([basis(at, np.array([0.0, 1.0]), count, n) for n in (0, 1, 2)])
    gram = [[b.T @ b / len(b) for b in part] for part in parts]
    (d0, d1, d2), (q0, q1, q2) = gram
    return np.asarray(np.kron(d2, q0) + 2 * np.kron(d1, q1) + np.kron(d0, q2))
