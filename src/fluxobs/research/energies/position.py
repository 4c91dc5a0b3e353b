"""Which coordinates flux and current determine: the paper's question on position and speed.

With K = ∂²H_E/∂λ² and the known flux and current, three ranks decide (docs/theorems.md, Theorems 7
and 9):

* ∂i/∂q: the coordinates that the current shows at once. Since ∂F/∂λ = -(∂i/∂q)ᵀ, they are those on
  which the flux acts with a force.
* n_E minus this rank: the number of independent relations between flux and current.
* dK/dq at constant current: the coordinates that current ripples show at rest, without knowledge of
  the flux.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from ...core.arrays import Array
from .system import ElectromechanicalSystem

#: Relative singular value below which a direction counts as not seen.
TOLERANCE = 1e-8
#: Search for other positions: states, starts of each, steps, and the distance (per range) below
#: which two positions are the same.
STATES, STARTS, STEPS, SAME = 8, 60, 40, 1e-4


@dataclass(frozen=True)
class PositionVisibility:
    """What flux and current tell of the coordinates of a system; ranks are those of typical states.

    Attributes
    ----------
    name : str
    ports, coordinates : int
        n_E and n_M.
    visible : int
        Rank of ∂i/∂q: coordinates that are visible at once. If it is n_M, position and speed follow
        from flux and current.
    relations : int
        n_E - visible: independent relations between flux and current.
    at_rest : int
        Coordinates that current ripples show at rest, with unknown flux.
    positions : int
        Number of positions in the system's range with the same flux and current; 0 if a coordinate
        is invisible, since then there is a continuum.
    """

    name: str
    ports: int
    coordinates: int
    visible: int
    relations: int
    at_rest: int
    positions: int


def current_by_position(
    system: ElectromechanicalSystem, flux: jax.Array, q: jax.Array
) -> jax.Array:
    """Return ∂i/∂q at constant flux (n_E, n_M)."""
    return jnp.asarray(jax.jacfwd(lambda q: system.current(flux, q))(q))


def inverse_inductance(system: ElectromechanicalSystem, flux: jax.Array, q: jax.Array) -> jax.Array:
    """Return K = ∂i/∂λ = ∂²H_E/∂λ² (n_E, n_E) [1/H]."""
    return jnp.asarray(jax.jacfwd(lambda flux: system.current(flux, q))(flux))


def inverse_inductance_by_position(
    system: ElectromechanicalSystem, flux: jax.Array, q: jax.Array
) -> jax.Array:
    """Return dK/dq at constant current (n_E, n_E, n_M): the flux moves by -K⁻¹ ∂i/∂q dq."""
    moved = -jnp.linalg.solve(
        inverse_inductance(system, flux, q), current_by_position(system, flux, q)
    )

    def along(dq: jax.Array, dflux: jax.Array) -> jax.Array:
        def K(flux: jax.Array, q: jax.Array) -> jax.Array:
            return inverse_inductance(system, flux, q)

        return jnp.asarray(jax.jvp(K, (flux, q), (dflux, dq))[1])

    return jnp.asarray(jax.vmap(along, (0, 1), 2)(jnp.eye(system.n_M), moved))


def velocity_from_flux(
    system: ElectromechanicalSystem,
    flux: jax.Array,
    q: jax.Array,
    flux_rate: jax.Array,
    current_rate: jax.Array,
) -> jax.Array:
    """Return q̇ = (∂i/∂q)⁺ (di/dt - K λ̇) (n_M,), if every coordinate is visible."""
    along = inverse_inductance(system, flux, q) @ flux_rate
    slope = current_by_position(system, flux, q)
    return _least_squares(slope, current_rate - along)


def _least_squares(matrix: jax.Array, right: jax.Array) -> jax.Array:
    """Return the least-squares solution for a matrix (n_E, n_M) of full column rank."""
    return jnp.asarray(jnp.linalg.solve(matrix.T @ matrix, matrix.T @ right))


def position_visibility(
    system: ElectromechanicalSystem, count: int = 64, seed: int = 0
) -> PositionVisibility:
    """Return what flux and current tell of the coordinates, from random states in the ranges."""
    flux, q = system.random_states(np.random.default_rng(seed), count)
    flux_unit = jnp.abs(system.flux_range).max(axis=0)
    q_unit = (system.position_range[1] - system.position_range[0]) / 2
    i = jax.jit(jax.vmap(system.current))(flux, q)
    i_unit = jnp.sqrt(jnp.mean(i**2, axis=0))

    @jax.jit
    @jax.vmap
    def derivatives(flux: jax.Array, q: jax.Array) -> tuple[jax.Array, jax.Array]:
        slope = current_by_position(system, flux, q) * q_unit / i_unit[:, None]
        ripple = inverse_inductance_by_position(system, flux, q)
        ripple = ripple * flux_unit[:, None] * q_unit / i_unit[:, None, None]
        return slope, ripple.reshape(-1, system.n_M)

    visible, at_rest = (_rank(np.asarray(matrices)) for matrices in derivatives(flux, q))
    positions = 0
    if visible == system.n_M:
        positions = _positions(system, flux[:STATES], i[:STATES], i_unit, q[:STATES], seed)
    return PositionVisibility(
        system.name, system.n_E, system.n_M, visible, system.n_E - visible, at_rest, positions
    )


def _rank(matrices: Array) -> int:
    """Return the rank of most of the matrices (count, rows, columns), relative to all of them."""
    singular = np.linalg.svd(matrices, compute_uv=False)
    largest = max(float(singular.max()), 1.0)
    return int(np.median((singular > TOLERANCE * largest).sum(axis=1)))


def _positions(
    system: ElectromechanicalSystem,
    flux: jax.Array,
    current: jax.Array,
    unit: jax.Array,
    true: jax.Array,
    seed: int,
) -> int:
    """Return how many positions have the same flux and current: Gauss-Newton from many starts.

    flux, current, true: a few states and their positions, one per row; their median counts.
    """
    low, high = system.position_range
    limit = (high - low) / 10  # a step of at most a tenth of the range stays near its start

    def residual(q: jax.Array, flux: jax.Array, current: jax.Array) -> jax.Array:
        return (system.current(flux, q) - current) / unit

    def solve(q: jax.Array, flux: jax.Array, current: jax.Array) -> tuple[jax.Array, jax.Array]:
        def step(_: int, q: jax.Array) -> jax.Array:
            slope = jax.jacfwd(residual)(q, flux, current)
            change = _least_squares(slope, -residual(q, flux, current))
            return q + jnp.clip(jnp.nan_to_num(change), -limit, limit)

        q = jax.lax.fori_loop(0, STEPS, step, q)
        return q, jnp.abs(residual(q, flux, current)).max()

    starts = low + (high - low) * jax.random.uniform(
        jax.random.key(seed), (len(flux), STARTS, len(low))
    )
    starts = jnp.concatenate([true[:, None], starts], axis=1)
    each = jax.vmap(jax.vmap(solve, (0, None, None)))
    ends, error = (np.asarray(values) for values in jax.jit(each)(starts, flux, current))
    span, first, last = np.asarray(high - low), np.asarray(low), np.asarray(high)
    inside = ((ends >= first - SAME * span) & (ends < last - SAME * span)).all(axis=2)
    solutions = inside & (error < 1e-9)
    return int(
        np.median([_distinct(q[good] / span) for q, good in zip(ends, solutions, strict=True)])
    )


def _distinct(points: Array) -> int:
    """Return the number of points (count, n_M) that differ by more than :data:`SAME`."""
    kept: list[Array] = []
    for point in points:
        if all(np.abs(point - other).max() > SAME for other in kept):
            kept.append(point)
    return len(kept)
