"""Stability of an adaptive law along a trajectory: the open question of the paper's Remark 7.

The error of Proposition 2 obeys ``χ' = (G_a - Γ Ψ Ψᵀ) χ``. On a periodic trajectory, the error's
Floquet multipliers decide stability. On any other trajectory, the error's largest Lyapunov exponent
decides; a record of finite length only approximates this exponent. Multipliers and exponent are
returned with their uncertainty.
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

#: Relative change of an exponent below which the step doubling ends; largest number of doublings.
CONVERGED, DOUBLINGS = 1e-5, 6
#: Number of times that neighbouring steps are multiplied in pairs before the growth is computed.
_JOINED = 4


class GainStudy(NamedTuple):
    """Growth of the error as a function of the gain.

    Attributes
    ----------
    gains : (k,) ndarray
    exponent : (k,) ndarray
        Largest growth rate [1/s]; for a periodic trajectory ``ln |multiplier| / period``.
    uncertainty : (k,) ndarray
        Change of the exponent when the steps are halved, plus, without a period, the change when
        the record is halved.
    """

    gains: Array
    exponent: Array
    uncertainty: Array

    @property
    def stable(self) -> NDArray[np.bool_]:
        """True where the exponent is below zero by more than its uncertainty."""
        return self.exponent < -self.uncertainty

    @property
    def unstable(self) -> NDArray[np.bool_]:
        """True where the exponent is above zero by more than its uncertainty."""
        return self.exponent > self.uncertainty

    def multipliers(self, period: float) -> Array:
        """Largest |Floquet multiplier| for each gain."""
        return np.asarray(np.exp(self.exponent * period))


def balanced_error_system(constants: Parametrisation, Gamma: Any) -> tuple[Array, Array]:
    """Return (G_a, L), with G_a in coordinates in which Γ is the identity, and ``Γ = L Lᵀ``.

    In these coordinates ψ = Lᵀ Ψ. The units of the constants do not affect the exponents.
    """
    n, size = constants.n, constants.n + len(constants)
    root = np.linalg.cholesky(np.asarray(positive_definite("Gamma", Gamma, size)))
    G_a = np.zeros((size, size))
    G_a[:n, n : 2 * n] = np.eye(n)
    return np.asarray(np.linalg.solve(root, G_a @ root)), np.asarray(root)


def floquet_multipliers(steps: ArrayLike) -> Array:
    """Return the eigenvalues of the product of one period's steps (steps, N, N), largest first."""
    values = np.linalg.eigvals(flow_product(np.asarray(steps, float)))
    return np.asarray(values[np.argsort(-np.abs(values))])


def weighted_mean(values: ArrayLike) -> float:
    """Return the mean with the weight ``exp(-1/(s (1 - s)))``, where s runs from 0 to 1.

    For a quasi-periodic signal, this mean converges faster than any power of the length; the plain
    mean converges as one over the length (S. Das, Y. Saiki, E. Sander, J. A. Yorke, "Quantitative
    quasiperiodicity", Nonlinearity 30, 2017, doi:10.1088/1361-6544/aa84c2).
    """
    signal = np.asarray(values, float)
    s = (np.arange(len(signal)) + 0.5) / len(signal)
    weight = np.exp(-1 / (s * (1 - s)))
    return float(weight @ signal / weight.sum())


def largest_exponent(steps: ArrayLike, h: float) -> tuple[float, float]:
    """Return (largest Lyapunov exponent [1/s], its change when the record is halved).

    Each step is h long. The first quarter is not used: there the error turns into the direction of
    largest growth.
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
    """Return ψ (steps, 3, N) of one period at the nodes of `steps` steps."""
    return np.stack([between(psi, steps, shift) for shift in NODES], axis=1)


def record_nodes(psi: Array, substeps: int) -> Array:
    """Return ψ (steps, 3, N) of a record at the nodes of `substeps` steps a row, by splines."""
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
    """Return the stability of Proposition 2's law along a trajectory for the gains γ Γ.

    Parameters
    ----------
    psi : (rows, n + n_θ) array_like
        Ψ in steps of h. If `periodic`, give one period in steady state; its last row is h before
        the end of the period (:func:`fluxobs.research.regression.periodic_regression`). Otherwise
        give a long record that resolves Ψ.
    h : float
        Sample time [s].
    constants : Parametrisation
    gains : sequence of float
        Values of γ.
    Gamma : number, vector or matrix
        Γ, the shape of the gain.
    periodic : bool
        If true, compute Floquet multipliers, else the largest Lyapunov exponent.

    Raises
    ------
    ModelError
        If Ψ is not finite, has the wrong width, or does not close although `periodic` is set.
    """
    regressor = np.asarray(psi, float)
    N, root = balanced_error_system(constants, Gamma)
    if regressor.ndim != 2 or regressor.shape[1] != len(N) or len(regressor) < 8:
        raise ModelError(f"psi must be (rows, {len(N)}), at least 8 rows, got {regressor.shape}")
    if not np.isfinite(regressor).all():
        raise ModelError(
            f"psi is not finite at row {int(np.argwhere(~np.isfinite(regressor))[0][0])}"
        )
    if periodic:
        _check_closed(regressor)
    exponent_of = _periodic_exponent if periodic else _record_exponent
    pairs = [exponent_of(N, np.sqrt(gain) * regressor @ root, h) for gain in gains]
    exponent, uncertainty = np.array(pairs).T
    return GainStudy(np.asarray(gains, float), exponent, uncertainty)


def _check_closed(psi: Array) -> None:
    """Raise ModelError if Ψ jumps from the end of the period to its start."""
    jump = np.abs(psi[0] - 2 * psi[-1] + psi[-2])
    inside = np.abs(np.diff(psi, n=2, axis=0)).max(axis=0)
    floor = np.maximum(1e-9 * np.abs(psi).max(axis=0), np.finfo(float).tiny)
    worst = float((jump / np.maximum(inside, floor)).max())
    if worst > 10:
        raise ModelError(
            f"psi is not periodic: at the end of the period, it bends {worst:.3g} times as much as "
            f"inside; give one period in steady state or periodic=False"
        )


def _converge(exponent: Callable[[int], float], rows: int, size: float) -> tuple[float, float]:
    """Double the steps until the exponent converges; return (exponent, its last change)."""
    value = exponent(rows)
    change = np.inf
    for doubling in range(1, DOUBLINGS + 1):
        finer = exponent(rows * 2**doubling)
        value, change = finer, abs(finer - value)
        if change < CONVERGED * max(abs(finer), CONVERGED * size):
            break
    return value, change


def _periodic_exponent(N: Array, psi: Array, h: float) -> tuple[float, float]:
    period = h * len(psi)

    def exponent(steps: int) -> float:
        P = _steps(N, periodic_nodes(psi, steps), period / steps)
        return float(np.log(np.abs(floquet_multipliers(P)[0])) / period)

    return _converge(exponent, len(psi), 1 / period)


def _record_exponent(N: Array, psi: Array, h: float) -> tuple[float, float]:
    coarse, short = largest_exponent(_steps(N, record_nodes(psi, 1), h), h)
    fine, _ = largest_exponent(_steps(N, record_nodes(psi, 2), h / 2), h / 2)
    return fine, short + abs(fine - coarse)
