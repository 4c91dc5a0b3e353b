"""Predict the identifiable unknowns from the constraint and check the prediction on a record."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import subspace_angles

from ...core.arrays import Array
from ...errors import ModelError
from ...machines.model.constraint import QuadraticConstraint, invisible_offsets
from ...machines.model.immersion import Immersion
from ..regression import Parametrisation, Regressors


def observability_gramian(
    rows: Regressors,
    constants: Parametrisation,
    h: float,
    window: float,
    scale: ArrayLike | None = None,
) -> Array:
    """Return ``∫ F(s,t)ᵀ Ψ Ψᵀ F(s,t) ds`` over the last window of a record; t is the record's end.

    The system is λ' = θ, y = Ψᵀ(λ, θ, …). Because the drift moves the flux, more directions are
    visible than Ψ alone excites: at constant speed the Ψ of a PMSM has rank 3 of 5, but this
    Gramian has full rank.

    Parameters
    ----------
    rows : Regressors
        Leading axis time.
    constants : Parametrisation
    h, window : float
        Sample time and window length [s].
    scale : (n + n_θ,) array_like, optional
        Size of each unknown.

    Returns
    -------
    (N, N) ndarray
    """
    count = round(window / h)
    if not 1 <= count <= len(rows.y):
        raise ModelError(f"a window of {window:g} s does not fit {len(rows.y)} rows of {h:g} s")
    psi = np.array(constants.psi_record(rows))[-count:]
    n = constants.n
    age = h * np.arange(count - 1, -1, -1)
    # Express row s in the state at t: λ(s) = λ(t) - (t - s) θ.
    psi[:, n : 2 * n] -= age[:, None] * psi[:, :n]
    if scale is not None:
        psi = psi * np.asarray(scale, float)
    return np.asarray(h * psi.T @ psi)


def immersion_gramian(
    immersion: Immersion,
    h: float,
    volt_seconds: ArrayLike,
    current: ArrayLike,
    scale: ArrayLike,
) -> Array:
    """Return ``∫ F(s,t)ᵀ H(s)ᵀ H(s) F(s,t) ds`` of the immersion over a record that ends at t.

    The least squares needs uniform observability: a lower bound of this Gramian over every window
    of one length. The paper requires persistency of excitation of Ψ, a stronger condition.

    Parameters
    ----------
    immersion : Immersion
    h : float
        Sample time [s].
    volt_seconds, current : (rows, n) array_like
        Volt-seconds of the interval that ends at each row [Wb]; current at the row [A].
    scale : (size,) array_like
        Size of each state.

    Returns
    -------
    (size, size) ndarray
    """
    v, i = np.asarray(volt_seconds, float), np.asarray(current, float)
    backward = np.diag(np.asarray(scale, float))
    total = np.zeros((immersion.size, immersion.size))
    for k in range(len(v) - 1, -1, -1):
        row = immersion.output_rows(i[k])[0] @ backward
        total += h * row.T @ row
        backward = immersion.transition(-h, -v[k]) @ backward
    return total


def invisible_from_gramian(gramian: ArrayLike, tolerance: float = 1e-10) -> Array:
    """Return the directions (N, k) invisible in a record: relative eigenvalue ≤ `tolerance`."""
    values, vectors = np.linalg.eigh(np.asarray(gramian, float))
    return np.asarray(vectors[:, values <= tolerance * values[-1]])


def invisible_from_constraint(constraint: QuadraticConstraint, constants: Parametrisation) -> Array:
    """Return the directions (N, k) of (λ, constants) that are invisible in every record.

    With the current bias as an unknown, these directions are the null space of the Hessian, whose
    vectors (r, s) are offsets of flux and bias. The printed parametrisation with the y_b block adds
    (s, 0, -2 Q1 s, -Q2ᵀ s), because it has more constants than the biases can produce (erratum 5).
    """
    n, size = constants.n, constants.n + len(constants)
    columns = []
    if constants.kind == "structured":
        for column in constraint.invisible_offsets().T:
            direction = np.zeros(size)
            # An offset s of i_m - δ is an offset -s of δ.
            direction[:n], direction[2 * n : 3 * n] = column[:n], -column[n:]
            columns.append(direction)
    elif constants.kind == "printed":
        for s in np.eye(n) if constants.with_b else []:
            direction = np.zeros(size)
            direction[:n] = s
            direction[2 * n : 3 * n] = -2 * constraint.Q1 @ s
            direction[3 * n : 4 * n] = -constraint.Q2.T @ s
            columns.append(direction)
        if not constants.with_b:
            # If Q3 = 0, the invisible s are the null space of Q2ᵀ.
            _, singular, vt = np.linalg.svd(constraint.Q2.T)
            for s in vt[singular <= 1e-9 * max(singular[0], 1e-300)]:
                direction = np.zeros(size)
                direction[:n], direction[2 * n : 3 * n] = s, -2 * constraint.Q1 @ s
                columns.append(direction)
    else:
        for column in invisible_offsets([constraint], ("drift",)).T:
            columns.append(np.r_[column[:n], np.zeros(size - n)])
    return np.array(columns).T if columns else np.empty((size, 0))


@dataclass(frozen=True, eq=False)
class InvisibleComparison:
    """Invisible directions, predicted from the constraint and measured on a record.

    Attributes
    ----------
    predicted, measured : (N, k) ndarray
    angle : float
        Largest principal angle between `predicted` and `measured` [rad]; NaN if their dimensions
        differ.
    """

    predicted: Array
    measured: Array
    angle: float

    @property
    def agree(self) -> bool:
        """Whether the record shows every direction that the constraint makes visible."""
        return self.predicted.shape == self.measured.shape and not self.angle > 1e-3


def compare_invisible(
    constraint: QuadraticConstraint,
    rows: Regressors,
    constants: Parametrisation,
    h: float,
    window: float,
    scale: ArrayLike,
    tolerance: float = 1e-10,
) -> InvisibleComparison:
    """Compare the prediction from the constraint with the observability Gramian of a record."""
    sizes = np.asarray(scale, float)
    measured = invisible_from_gramian(
        observability_gramian(rows, constants, h, window, sizes), tolerance
    )
    predicted = invisible_from_constraint(constraint, constants) / sizes[:, None]
    if predicted.shape != measured.shape:
        angle = float("nan")
    elif measured.shape[1] == 0:
        angle = 0.0
    else:
        angle = float(np.max(subspace_angles(predicted, measured)))
    return InvisibleComparison(predicted, measured, angle)


def rank(gramian: ArrayLike, tolerance: float = 1e-10) -> int:
    """Return the number of visible directions."""
    values = np.linalg.eigvalsh(np.asarray(gramian, float))
    return int((values > tolerance * values[-1]).sum())
