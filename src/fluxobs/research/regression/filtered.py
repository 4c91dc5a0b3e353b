"""Lemma 1 of the paper in continuous time: nine filters, for any number of ports.

This module makes two corrections (docs/errata.md). In Φ_λ, y_a gets the factor ν. The constant
entry of y_b is omitted because its regressor decays to zero. ``form="printed"`` keeps the paper's
Φ_λ to show the error.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from ...core.arrays import Array
from ...errors import ModelError
from ...machines.model.constraint import QuadraticConstraint
from .regressors import Regressors


class Filters(NamedTuple):
    """ξ1 … ξ9 of the paper; ξ5 and ξ9 are scalars, all other filters are vectors (n,)."""

    xi1: jax.Array
    xi2: jax.Array
    xi3: jax.Array
    xi4: jax.Array
    xi5: jax.Array
    xi6: jax.Array
    xi7: jax.Array
    xi8: jax.Array
    xi9: jax.Array


class FilteredRegression(eqx.Module):
    """The paper's filters and regression, which apply ``g ↔ ν p²/(p + ν)²`` to the constraint.

    Parameters
    ----------
    constraint : QuadraticConstraint
    corner : float
        ν [rad/s], > 0. The regression holds except for a transient e^{-νt}(1 + νt).
    form : {"corrected", "printed"}
    """

    Q1: jax.Array
    Q2: jax.Array
    Q3: jax.Array
    E: jax.Array
    C: jax.Array
    corner: float
    form: Literal["corrected", "printed"] = eqx.field(static=True)

    def __init__(
        self,
        constraint: QuadraticConstraint,
        corner: float,
        form: Literal["corrected", "printed"] = "corrected",
    ) -> None:
        if not corner > 0:
            raise ModelError(f"corner must be positive, got {corner}")
        for name in ("Q1", "Q2", "Q3", "E", "C"):
            setattr(self, name, jnp.asarray(getattr(constraint, name)))
        self.corner = float(corner)
        self.form = form

    def init(self) -> Filters:
        """Return all filters with value zero."""
        zero, scalar = jnp.zeros(len(self.E)), jnp.zeros(())
        return Filters(zero, zero, zero, zero, scalar, zero, zero, zero, scalar)

    # The methods below use only operators, so they also work on many rows at once and, with
    # `_plain`, in NumPy.

    def known(self, current: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return (y_a, y_c) of the corollary; y_b is the current itself."""
        y_c = _dot(current @ self.Q3, current) + current @ self.C
        return current @ self.Q2.T + self.E, y_c

    def derivative(self, xi: Filters, y_m: jax.Array, current: jax.Array) -> Filters:
        """Return the time derivative for ``y_m = -R i_m + B u_m`` [V] and measured current [A]."""
        nu, forcing = self.corner, y_m @ self.Q1.T
        y_a, y_c = self.known(current)
        return Filters(
            -nu * xi.xi1 + nu * y_m,
            -nu * xi.xi2 + 2 * nu * forcing - nu**2 * y_a,
            -nu * xi.xi3 + nu * current,
            -nu * xi.xi4 + xi.xi2 + 2 * forcing,
            -nu * xi.xi5 + _dot(y_m, xi.xi2) + nu**2 * y_c,
            -nu * xi.xi6 + nu * xi.xi4 - xi.xi2,
            -nu * xi.xi7 + nu * xi.xi1,
            -nu * xi.xi8 + nu * (current - xi.xi3),
            -nu * xi.xi9 + nu * xi.xi5 - nu**2 * y_c + _dot(y_m, nu * xi.xi4 - xi.xi2),
        )

    def read_out(self, xi: Filters, current: jax.Array) -> Regressors:
        """Return the regression at this instant."""
        nu = self.corner
        y_a, y_c = self.known(current)
        scale = 1.0 if self.form == "printed" else nu
        return Regressors(
            xi.xi5 - nu * y_c - xi.xi9,
            2 * xi.xi2 + scale * y_a - nu * xi.xi4,
            2 * xi.xi6,
            xi.xi1 - xi.xi7,
            nu * (current - xi.xi3 - xi.xi8),
            0 * y_c + 2 / nu,  # one value for every row
        )


def _dot(a: jax.Array, b: jax.Array) -> jax.Array:
    return (a * b).sum(axis=-1)


def _plain(regression: FilteredRegression) -> FilteredRegression:
    """Return this regression in NumPy, which needs no compilation for each new record length."""
    plain: FilteredRegression = jax.tree.map(np.asarray, regression)
    return plain


#: Groups of filters. Each group needs the signals and the groups before it.
_CASCADE = (("xi1", "xi2", "xi3"), ("xi4", "xi5", "xi7", "xi8"), ("xi6", "xi9"))


def cascade(
    regression: FilteredRegression, lag: Callable[[Array], Array], y_m: Array, current: Array
) -> Filters:
    """Return the nine filters; each is a lag ``x' = -ν x + signal`` driven by earlier filters.

    Parameters
    ----------
    regression : FilteredRegression
    lag : callable
        Returns x for a signal of shape (...) or (..., n); the leading axis is time.
    y_m, current : (..., n) ndarray
    """
    plain: Any = _plain(regression)
    vector: Any = np.zeros(y_m.shape)
    scalar: Any = np.zeros(y_m.shape[:-1])
    xi = Filters(vector, vector, vector, vector, scalar, vector, vector, vector, scalar)
    for names in _CASCADE:
        # If the filter's value is zero, its derivative is its signal.
        signals = plain.derivative(xi, y_m, current)
        outputs: dict[str, Any] = {name: lag(getattr(signals, name)) for name in names}
        xi = xi._replace(**outputs)
    return xi


#: Relative positions of the signal values in an interval: start, middle, end.
PLACES: Array = np.array([0.0, 0.5, 1.0])


def _weights(z: float, until: float) -> Array:
    """Return weights of the values at :data:`PLACES` in ∫₀^until e^{-z (until - τ)} p(τ) dτ."""
    nodes, weights = np.polynomial.legendre.leggauss(16)
    tau = until * (nodes + 1) / 2
    lagrange = np.array([(1 - tau) * (1 - 2 * tau), 4 * tau * (1 - tau), tau * (2 * tau - 1)])
    return np.asarray(lagrange @ (np.exp(-z * (until - tau)) * weights) * until / 2)


def filter_record(
    regression: FilteredRegression,
    h: float,
    y_m: ArrayLike,
    current: ArrayLike,
) -> Filters:
    """Return the filters at every sample of a record; they start at zero.

    Every filter is a lag driven by earlier filters. Its integration is exact if the inputs are
    parabolas in each interval; the only error is the deviation of the inputs from parabolas.

    Parameters
    ----------
    regression : FilteredRegression
    h : float
        Sample time [s].
    y_m, current : (rows - 1, 3, n) array_like
        Values at the start, middle and end of each interval; they may jump at samples.

    Returns
    -------
    Filters
        The leading axis is rows.
    """
    z = regression.corner * h
    y, i = np.asarray(y_m, float), np.asarray(current, float)
    whole, half = h * _weights(z, 1.0), h * _weights(z, 0.5)

    def lag(signal: Array) -> Array:
        """Return x of ``x' = -ν x + signal``, starting at zero, at the places of the signal."""
        increment = np.tensordot(signal, whole, axes=(1, 0))
        end = lfilter([1.0], [1.0, -np.exp(-z)], increment, axis=0)
        start = np.concatenate([np.zeros((1, *end.shape[1:])), end[:-1]])
        middle = np.exp(-z / 2) * start + np.tensordot(signal, half, axes=(1, 0))
        return np.stack([start, middle, end], axis=1)

    inside = cascade(regression, lag, y, i)
    samples: Any = (np.concatenate([xi[:1, 0], xi[:, 2]]) for xi in inside)
    return Filters(*samples)


def read_out_record(
    regression: FilteredRegression, filters: Filters, current: ArrayLike
) -> Regressors:
    """Return the regression at every sample from the filters and measured currents (rows, n)."""
    i: Any = np.asarray(current, float)
    return _plain(regression).read_out(filters, i)
