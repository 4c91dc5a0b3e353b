"""The linear regression of Lemma 1 and parametrisations of its unknown constants."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ...errors import ModelError
from ...machines.model.constraint import QuadraticConstraint
from ...simulation.precision import real


class Regressors(NamedTuple):
    """``y = Φ_fluxᵀλ + Φ_driftᵀθ + Φ_aᵀθ_a + Φ_bᵀθ_b + φ_c θᵀQ1θ`` with θ_a = -Q2 δ_i,
    θ_b = -2 Q3 δ_i. In a record, the leading axis is time.
    """

    y: jax.Array  # ()
    Phi_flux: jax.Array  # (n,)
    Phi_drift: jax.Array  # (n,)
    Phi_a: jax.Array  # (n,)
    Phi_b: jax.Array  # (n,)
    phi_c: jax.Array  # ()

    def part(self, rows: Any) -> Regressors:
        """Return rows of a record (slice, mask or numbers) in NumPy, which needs no compilation."""
        selected: Any = (np.asarray(entries)[rows] for entries in self)
        return Regressors(*selected)


Kind = Literal["printed", "structured", "voltage-bias"]
KINDS: tuple[Kind, ...] = get_args(Kind)


class Parametrisation(eqx.Module):
    """The constants estimated besides the flux, and their regressors.

    The first constants are always the drift θ.

    Parameters
    ----------
    constraint : QuadraticConstraint
    kind : {"printed", "structured", "voltage-bias"}
        "printed" is the paper's (θ, θ_a, θ_b, 2/ν θᵀQ1θ) without the entry 1 of y_b, whose
        regressor vanishes. "structured" is (θ, δ_i, θᵀQ1θ), with θ_a and θ_b as known functions of
        one current bias. "voltage-bias" is (θ, θᵀQ1θ), exact if the currents have no bias.
    corner : float
        ν of the filters [rad/s]; it scales the last constant as in the paper.

    Notes
    -----
    With a regular Q1, the printed regressor is persistently exciting only if Q3 = 0, because
    ``Φ_flux = 2 Q1 Φ_a + Q2 Φ_b`` up to decaying terms (erratum 5).
    """

    Q1: jax.Array
    Q2: jax.Array
    Q3: jax.Array
    corner: float
    kind: Kind = eqx.field(static=True)
    with_b: bool = eqx.field(static=True)
    with_c: bool = eqx.field(static=True)

    def __init__(self, constraint: QuadraticConstraint, kind: Kind, corner: float) -> None:
        if kind not in KINDS:
            raise ModelError(f"parametrisation must be one of {', '.join(KINDS)}, got {kind!r}")
        self.Q1, self.Q2 = jnp.asarray(constraint.Q1), jnp.asarray(constraint.Q2)
        self.Q3 = jnp.asarray(constraint.Q3)
        self.corner = corner
        self.kind = kind
        # Omit a block whose coefficients are zero for any bias.
        self.with_b = bool(np.any(constraint.Q3 != 0))
        self.with_c = bool(np.any(constraint.Q1 != 0))

    @property
    def n(self) -> int:
        return len(self.Q1)

    def regressor(self, row: Regressors) -> jax.Array:
        """Return Φ_θ (n_θ,) of one row."""
        blocks = [row.Phi_drift]
        if self.kind == "printed":
            blocks.append(row.Phi_a)
            if self.with_b:
                blocks.append(row.Phi_b)
        elif self.kind == "structured":
            blocks.append(-(self.Q2.T @ row.Phi_a + 2 * self.Q3 @ row.Phi_b))
        if self.with_c:
            blocks.append(row.phi_c[None] * self.corner / 2)
        return jnp.concatenate(blocks)

    def constants(self, drift: Any, current_bias: Any) -> NDArray[np.float64]:
        """Return the true constants (n_θ,) for a drift [V] and a current bias [A]."""
        theta = np.asarray(real("drift", drift, (self.n,)))
        delta = np.asarray(real("current_bias", current_bias, (self.n,)))
        Q1, Q2, Q3 = (np.asarray(matrix) for matrix in (self.Q1, self.Q2, self.Q3))
        blocks = [theta]
        if self.kind == "printed":
            blocks.append(-Q2 @ delta)
            if self.with_b:
                blocks.append(-2 * Q3 @ delta)
        elif self.kind == "structured":
            blocks.append(delta)
        if self.with_c:
            blocks.append(np.array([2 / self.corner * theta @ Q1 @ theta]))
        return np.concatenate(blocks)

    @eqx.filter_jit
    def record(self, rows: Regressors) -> jax.Array:
        """Return Φ_θ (rows, n_θ) of all rows."""
        return jax.vmap(self.regressor)(rows)

    def psi(self, row: Regressors) -> jax.Array:
        """Return Ψ = (Φ_λ, Φ_θ) of one row as an array (n + n_θ,)."""
        return jnp.concatenate([row.Phi_flux, self.regressor(row)])

    @eqx.filter_jit
    def psi_record(self, rows: Regressors) -> jax.Array:
        """Return Ψ (rows, n + n_θ) of all rows."""
        return jax.vmap(self.psi)(rows)

    def __len__(self) -> int:
        vectors = {"printed": 2 + self.with_b, "structured": 2, "voltage-bias": 1}[self.kind]
        return vectors * self.n + self.with_c


def residual(
    rows: Regressors, constraint: QuadraticConstraint, flux: Any, drift: Any, current_bias: Any
) -> jax.Array:
    """Return y minus the terms of true flux, drift and current bias, with the axes of `rows`."""
    Q1, Q2, Q3 = (jnp.asarray(getattr(constraint, name)) for name in ("Q1", "Q2", "Q3"))
    theta, delta = jnp.asarray(drift), jnp.asarray(current_bias)
    explained = (
        jnp.einsum("...i,...i", rows.Phi_flux, jnp.asarray(flux))
        + rows.Phi_drift @ theta
        - rows.Phi_a @ (Q2 @ delta)
        - 2 * rows.Phi_b @ (Q3 @ delta)
        + rows.phi_c * (theta @ Q1 @ theta)
    )
    return rows.y - explained
