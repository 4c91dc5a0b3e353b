"""The quadratic relation between flux linkage and current, valid at every position."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from ...core.arrays import Array
from ...errors import ModelError


def _freeze(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return a read-only copy; raise ModelError unless it has this shape and is finite."""
    array = np.array(value, dtype=float)
    if array.shape != shape:
        raise ModelError(f"{name} must have shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ModelError(f"{name} must be finite, got {array.tolist()}")
    array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False)
class QuadraticConstraint:
    """The relation ``0 = λᵀQ1 λ + λᵀQ2 i + iᵀQ3 i + Eᵀλ + Cᵀi + d``.

    It is Assumption 1 of the paper plus the linear term ``Eᵀλ`` for magnet-biased coils. Only the
    symmetric parts of Q1 and Q3 matter, so they are symmetrised on input.

    Parameters
    ----------
    Q1, Q2, Q3 : (n, n) array_like
        Units must be consistent. For the machines here, Q1 = I, Q2 is in H and Q3 in H².
    E, C : (n,) array_like, optional
        Default 0.
    d : float, optional
        Default 0. No observer needs d, because the immersion's state s contains it.

    Raises
    ------
    ModelError
        A shape does not fit or an entry is not finite.

    References
    ----------
    A. Pyrkin, A. Vedyakov, R. Ortega, A. Bobtsov, "A Robust Adaptive Flux Observer for a Class of
    Electromechanical Systems", Assumption 1.

    Examples
    --------
    >>> import numpy as np
    >>> constraint = QuadraticConstraint(np.eye(2), -2e-3 * np.eye(2), 1e-6 * np.eye(2), d=-0.01)
    >>> float(constraint.residual([0.101, 0.0], [1.0, 0.0]).round(12))
    0.0
    """

    Q1: Array
    Q2: Array
    Q3: Array
    E: Array = field(default_factory=lambda: np.empty(0))  # empty: zeros
    C: Array = field(default_factory=lambda: np.empty(0))
    d: float = 0.0

    def __post_init__(self) -> None:
        n = len(np.atleast_1d(self.Q1))
        for name in ("Q1", "Q2", "Q3"):
            matrix = _freeze(name, getattr(self, name), (n, n))
            if name != "Q2":
                matrix = _freeze(name, (matrix + matrix.T) / 2, (n, n))
            object.__setattr__(self, name, matrix)
        for name in ("E", "C"):
            value = getattr(self, name)
            object.__setattr__(
                self, name, _freeze(name, np.zeros(n) if np.size(value) == 0 else value, (n,))
            )
        object.__setattr__(self, "d", float(_freeze("d", self.d, ())))

    @property
    def n(self) -> int:
        """Number of electrical ports."""
        return len(self.E)

    def residual(self, flux: ArrayLike, current: ArrayLike) -> Array:
        """Return w(λ, i), which is zero for the machine's flux and current.

        Parameters
        ----------
        flux, current : (..., n) array_like
            Flux linkage [Wb] and current [A].

        Returns
        -------
        (...) ndarray
        """
        x, i = np.asarray(flux, float), np.asarray(current, float)
        return np.asarray(
            np.einsum("...i,ij,...j", x, self.Q1, x)
            + np.einsum("...i,ij,...j", x, self.Q2, i)
            + np.einsum("...i,ij,...j", i, self.Q3, i)
            + x @ self.E
            + i @ self.C
            + self.d
        )

    def hessian(self) -> Array:
        """Return the second derivative in (λ, i), shape (2n, 2n): ``[[2 Q1, Q2], [Q2ᵀ, 2 Q3]]``."""
        return np.block([[2 * self.Q1, self.Q2], [self.Q2.T, 2 * self.Q3]])

    def invisible_offsets(self) -> Array:
        """Return constant offsets of (λ, i) that the relation cannot detect; shape (2n, k).

        The function :func:`invisible_offsets` does the same for several relations.
        """
        return invisible_offsets([self])


def invisible_offsets(
    relations: Sequence[QuadraticConstraint],
    unknowns: Iterable[str] = ("drift", "current-bias"),
    R: ArrayLike | None = None,
) -> Array:
    """Return constant offsets of (λ, i) that no record can reveal.

    These offsets form the null space of the relations' stacked Hessians, restricted to possible
    offsets. If only the drift is unknown, the current has no offset. If only the current bias is
    unknown, R s = 0, because otherwise the flux offset would drift. If the null space is empty,
    excitation reveals all unknowns. For a surface PMSM with both unknowns, the offsets (L s, s)
    span the null space; they change neither λ - L i nor the position. See docs/theory.md, section
    3.

    Parameters
    ----------
    relations : sequence of QuadraticConstraint
    unknowns : iterable of {"drift", "current-bias"}
    R : (n, n) array_like
        Resistance [Ω]; needed if the current bias is the only unknown.

    Returns
    -------
    (2n, k) ndarray
        One offset (r, s) per column, in Wb and A, orthonormal after scaling by typical sizes.
    """
    n, unknown = relations[0].n, set(unknowns)
    hessians = np.stack([relation.hessian() for relation in relations])
    # Ports, fluxes and currents differ in magnitude: scale rows and columns before finding the
    # rank.
    scale = np.ones(2 * n)
    for _ in range(20):
        largest = np.abs(scale[:, None] * hessians * scale).max(axis=(0, 1))
        scale = scale / np.sqrt(np.where(largest > 0, largest, 1.0))
    rows = [scale[:, None] * hessian * scale for hessian in hessians]
    zero = np.zeros((n, n))
    if "current-bias" not in unknown:
        rows.append(np.hstack([zero, np.eye(n)]))
    elif "drift" not in unknown:
        if R is None:
            raise ModelError("R is missing; it gives the drift if only the current bias is unknown")
        rows.append(np.hstack([zero, np.asarray(R, float) * scale[n:]]))
    stacked = np.vstack(rows)
    sizes = np.abs(stacked).max(axis=1, keepdims=True)
    _, singular, vt = np.linalg.svd(stacked / np.where(sizes > 0, sizes, 1.0))
    rank = int((singular > 1e-9 * max(singular[0], 1e-300)).sum())
    return np.asarray(scale[:, None] * vt[rank:].T)
