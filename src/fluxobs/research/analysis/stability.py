"""Is an adaptive law stable along this trajectory? Remark 7 leaves the number to the reader.

The error of Proposition 2 obeys ``χ' = (G_a - Γ Ψ Ψᵀ) χ``. On a periodic trajectory its Floquet
multipliers decide stability. On any other its largest Lyapunov exponent does, which a record of
finite length only approaches. Both come with the uncertainty of the number.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from ...core.arrays import Array
from ...errors import ModelError
from ..regression import Parametrisation
from ..regression.laws.base import positive_definite
from ..regression.periodic import between
from .flow import NODES, flow_growth, flow_joined, flow_product, flow_steps

#: Steps a period are doubled until no exponent changes by more than this share, or this often.
CONVERGED, DOUBLINGS = 1e-5, 6
#: Steps are joined by twos this often before the growth of a vector is followed.
_JOINED = 4


class GainStudy(NamedTuple):
    """Growth of the error as a function of the gain.

    Attributes
    ----------
    gains : (k,) ndarray
    exponent : (k,) ndarray
        Largest growth rate [1/s]: of periodic trajectories ``ln |multiplier| / period``.
    uncertainty : (k,) ndarray
        Change of the exponent when the steps are halved and, without a period, when the record is.
    """

    gains: Array
    exponent: Array
    uncertainty: Array

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Where the exponent is below zero by more than its uncertainty."""
        return self.exponent < -self.uncertainty

    @property
    def unstable(self) -> NDArray[np.bool_]:
        """Where the exponent is above zero by more than its uncertainty."""
        return self.exponent > self.uncertainty

    def multipliers(self, period: float) -> Array:
        """Largest |Floquet multiplier| for each gain."""
        return np.asarray(np.exp(self.exponent * period))


def balanced_error_system(constants: Parametrisation, Gamma: Any) -> tuple[Array, Array]:
    """G_a in coordinates in which Γ is the identity, and the root L of ``Γ = L Lᵀ``.

    There ψ = Lᵀ Ψ, and the units of the constants do not matter; nor do they to the exponents.
    """
    n, size = constants.n, constants.n + len(constants)
    root = np.linalg.cholesky(np.asarray(positive_definite("Gamma", Gamma, size)))
    G_a = np.zeros((size, size))
    G_a[:n, n : 2 * n] = np.eye(n)
    return np.asarray(np.linalg.solve(root, G_a @ root)), np.asarray(root)


def floquet_multipliers(steps: ArrayLike) -> Array:
    """Eigenvalues of the product of all steps of one period, (steps, N, N); largest first."""
    values = np.linalg.eigvals(flow_product(np.asarray(steps, float)))
    return np.asarray(values[np.argsort(-np.abs(values))])


def weighted_mean(values: ArrayLike) -> float:
    """Mean under the weight ``exp(-1/(s (1 - s)))``, s from 0 to 1 along the values.

    Of a quasi-periodic signal it converges faster than any power of the length, where the plain
    mean converges as one over the length (S. Das, Y. Saiki, E. Sander, J. A. Yorke, "Quantitative
    quasiperiodicity", Nonlinearity 30, 2017, doi:10.1088/1361-6544/aa84c2).
    """
    given = np.asarray(values, float)
    s = (np.arange(len(given)) + 0.5) / len(given)
    weight = np.exp(-1 / (s * (1 - s)))
    return float(weight @ given / weight.sum())


def largest_exponent(steps: ArrayLike, h: float) -> tuple[float, float]:
    """Largest Lyapunov exponent [1/s] of steps h long, and its change when the record is halved.

    The first quarter lets the error turn into the direction that grows most.
    """
    joined = flow_joined(np.asarray(steps, float), _JOINED)
    growth = flow_growth(joined) / (2**_JOINED * h)
    used = growth[len(growth) // 4 :]
    whole = weighted_mean(used)
    return whole, abs(weighted_mean(used[len(used) // 2 :]) - whole)


def _steps(N: Array, psi: Array, h: float) -> Array:
    P, _ = flow_steps(N, psi, h)
    if not np.isfinite(P).all():
        raise ModelError(f"the transition over {h:g} s is not finite: the gain is too large")
    return P


def periodic_nodes(psi: Array, steps: int) -> Array:
    """ψ of one period at the nodes of `steps` steps, (steps, 3, N)."""
    return np.stack([between(psi, steps, shift) for shift in NODES], axis=1)


def record_nodes(psi: Array, substeps: int) -> Array:
    """ψ of a record at the nodes of `substeps` steps a row, by cubic splines, (steps, 3, N)."""
    steps = (len(psi) - 1) * substeps
    places = (np.arange(steps)[:, None] + NODES) / substeps
    return np.asarray(CubicSpline(np.arange(len(psi)), psi)(places))


def over_gain(
    psi: ArrayLike,
    h: float,
    constants: Parametrisation,
    gains: Sequence[float],
    Gamma: Any = 1.0,
    periodic: bool = True,
) -> GainStudy:
    """Stability of Proposition 2 along a trajectory for the gains γ Γ.

    Parameters
    ----------
    psi : (rows, n + n_θ) array_like
        Ψ in steps of h. If `periodic`, one period in steady state that ends h before it repeats
        (:func:`fluxobs.research.regression.periodic_regression`); else a record, the longer the
        better, that resolves Ψ.
    h : float
        Sample time [s].
    constants : Parametrisation
    gains : sequence of float
        Values of γ.
    Gamma : number, vector or matrix
        Γ, the shape of the gain.
    periodic : bool
        Floquet multipliers if true, else the largest Lyapunov exponent.

    Raises
    ------
    ModelError
        Ψ is not finite, has the wrong width, or does not close where it should be periodic.
    """
    given = np.asarray(psi, float)
    N, root = balanced_error_system(constants, Gamma)
    if given.ndim != 2 or given.shape[1] != len(N) or len(given) < 8:
        raise ModelError(f"psi must be (rows, {len(N)}), at least 8 rows, got {given.shape}")
    if not np.isfinite(given).all():
        raise ModelError(f"psi is not finite at row {int(np.argwhere(~np.isfinite(given))[0][0])}")
    if periodic:
        _closes(given)
    one = _periodic if periodic else _along
    found = [one(N, np.sqrt(gain) * given @ root, h) for gain in gains]
    exponent, uncertainty = np.array(found).T
    return GainStudy(np.asarray(gains, float), exponent, uncertainty)


def _closes(psi: Array) -> None:
    """Refuses a Ψ that jumps where the period starts again."""
    jump = np.abs(psi[0] - 2 * psi[-1] + psi[-2])
    inside = np.abs(np.diff(psi, n=2, axis=0)).max(axis=0)
    least = np.maximum(1e-9 * np.abs(psi).max(axis=0), np.finfo(float).tiny)
    worst = float((jump / np.maximum(inside, least)).max())
    if worst > 10:
        raise ModelError(
            f"not periodic: where the period starts again the regressor bends {worst:.3g} times as "
            f"much as inside; give one period in steady state, or periodic=False"
        )


def _doubled(exponent: Callable[[int], float], rows: int, size: float) -> tuple[float, float]:
    """Exponent with the steps doubled until it stays, and its last change."""
    value = exponent(rows)
    change = np.inf
    for doubling in range(1, DOUBLINGS + 1):
        finer = exponent(rows * 2**doubling)
        value, change = finer, abs(finer - value)
        if change < CONVERGED * max(abs(finer), CONVERGED * size):
            break
    return value, change


def _periodic(N: Array, psi: Array, h: float) -> tuple[float, float]:
    period = h * len(psi)

    def exponent(steps: int) -> float:
        P = _steps(N, periodic_nodes(psi, steps), period / steps)
        return float(np.log(np.abs(floquet_multipliers(P)[0])) / period)

    return _doubled(exponent, len(psi), 1 / period)


def _along(N: Array, psi: Array, h: float) -> tuple[float, float]:
    coarse, short = largest_exponent(_steps(N, record_nodes(psi, 1), h), h)
    fine, _ = largest_exponent(_steps(N, record_nodes(psi, 2), h / 2), h / 2)
    return fine, short + abs(fine - coarse)
