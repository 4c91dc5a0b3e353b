"""Lemma 1 of the paper in continuous time: nine filters, for any number of ports.

Corrected (docs/errata.md): ν stands before y_a in Φ_λ, and the constant entry of y_b, whose
regressor decays to zero, is left out. ``form="printed"`` keeps the paper's Φ_λ, to show the error.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ...errors import ModelError
from ...model.constraint import QuadraticConstraint
from .regressors import Regressors


class Filters(NamedTuple):
    """ξ1 … ξ9 of the paper; ξ5 and ξ9 are scalars, the others vectors (n,)."""

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
    """The paper's filters and regression, ``g ↔ ν p²/(p + ν)²`` applied to the constraint.

    Parameters
    ----------
    constraint : QuadraticConstraint
    corner : float
        ν [rad/s], > 0. The regression holds up to a transient e^{-νt}(1 + νt).
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
        """All filters at zero."""
        zero, scalar = jnp.zeros(len(self.E)), jnp.zeros(())
        return Filters(zero, zero, zero, zero, scalar, zero, zero, zero, scalar)

    def known(self, current: jax.Array) -> tuple[jax.Array, jax.Array]:
        """y_a and y_c of the corollary (y_b is the current itself)."""
        y_c = current @ self.Q3 @ current + self.C @ current
        return self.Q2 @ current + self.E, y_c

    def derivative(self, xi: Filters, y_m: jax.Array, current: jax.Array) -> Filters:
        """Time derivative, given ``y_m = -R i_m + B u_m`` [V] and the measured current [A]."""
        nu, Q1 = self.corner, self.Q1
        y_a, y_c = self.known(current)
        return Filters(
            -nu * xi.xi1 + nu * y_m,
            -nu * xi.xi2 + 2 * nu * Q1 @ y_m - nu**2 * y_a,
            -nu * xi.xi3 + nu * current,
            -nu * xi.xi4 + xi.xi2 + 2 * Q1 @ y_m,
            -nu * xi.xi5 + y_m @ xi.xi2 + nu**2 * y_c,
            -nu * xi.xi6 + nu * xi.xi4 - xi.xi2,
            -nu * xi.xi7 + nu * xi.xi1,
            -nu * xi.xi8 + nu * (current - xi.xi3),
            -nu * xi.xi9 + nu * xi.xi5 - nu**2 * y_c + y_m @ (nu * xi.xi4 - xi.xi2),
        )

    def read_out(self, xi: Filters, current: jax.Array) -> Regressors:
        """The regression at this moment."""
        nu = self.corner
        y_a, y_c = self.known(current)
        scale = 1.0 if self.form == "printed" else nu
        return Regressors(
            xi.xi5 - nu * y_c - xi.xi9,
            2 * xi.xi2 + scale * y_a - nu * xi.xi4,
            2 * xi.xi6,
            xi.xi1 - xi.xi7,
            nu * (current - xi.xi3 - xi.xi8),
            jnp.asarray(2 / nu),
        )


@eqx.filter_jit
def filter_record(
    regression: FilteredRegression,
    h: float,
    y_m: jax.Array,
    current: jax.Array,
) -> Filters:
    """Filters at every sample of a record, by Runge and Kutta's fourth order, from zero.

    Parameters
    ----------
    regression : FilteredRegression
    h : float
        Sample time [s]; ν h up to about 0.1.
    y_m, current : (rows - 1, 3, n) array
        At the beginning, middle and end of each interval, so that both may jump at samples.

    Returns
    -------
    Filters
        Leading axis rows.
    """

    def add(xi: Filters, rate: Filters, step: float) -> Filters:
        return Filters(*(a + step * b for a, b in zip(xi, rate, strict=True)))

    def body(xi: Filters, signals: tuple[jax.Array, jax.Array]) -> tuple[Filters, Filters]:
        y, i = signals
        k1 = regression.derivative(xi, y[0], i[0])
        k2 = regression.derivative(add(xi, k1, h / 2), y[1], i[1])
        k3 = regression.derivative(add(xi, k2, h / 2), y[1], i[1])
        k4 = regression.derivative(add(xi, k3, h), y[2], i[2])
        total = Filters(*(a + 2 * b + 2 * c + d for a, b, c, d in zip(k1, k2, k3, k4, strict=True)))
        xi = add(xi, total, h / 6)
        return xi, xi

    start = regression.init()
    _, rest = jax.lax.scan(body, start, (y_m, current))
    return Filters(
        *(jnp.concatenate([first[None], later]) for first, later in zip(start, rest, strict=True))
    )


@eqx.filter_jit
def read_out_record(
    regression: FilteredRegression, filters: Filters, current: jax.Array
) -> Regressors:
    """The regression at every sample, from filters and measured currents (rows, n)."""
    return jax.vmap(regression.read_out)(filters, current)
