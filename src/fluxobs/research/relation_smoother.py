"""Estimate every row of a record from all of its rows, for any relation and any number of ports.

The record is the nonlinear least-squares problem

    minimise Σ |i - i*|²/σ_i² + Σ |λ₊ - λ - v - hθ|²/(h σ_u)² + priors   with h(λ, η, i*) = 0,

solved by Gauss-Newton steps. Each step is a Kalman filter forwards, linearised at the trajectory of
the step before, and the adjoint recursion backwards, which needs no inverse of a covariance
(docs/theorems.md, Theorem 8).

References
----------
B. M. Bell, "The iterated Kalman smoother as a Gauss-Newton method", SIAM Journal on Optimization 4,
1994, doi:10.1137/0804035.

G. J. Bierman, "Fixed interval smoothing with discrete measurements", International Journal of
Control 18, 1973, doi:10.1080/00207177308932487.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..core.arrays import Array
from ..errors import ModelError, RecordError
from ..simulation.precision import real
from .relation_observer import RelationObserver, columns, records

#: Largest number of Gauss-Newton steps; change, in standard deviations, below which they end. With
#: little excitation, a step reduces the remaining change by a fifth only.
STEPS, CONVERGED = 40, 0.03
#: Slope uncertainty up to which the standard deviations hold. Noisy records of the levitation whose
#: errors are as stated have at most 0.56; those of scenario S1, which are not, at least 0.69.
LINEAR = 0.6


def integrated_flux(flux: Any, drift: Any, volt_seconds: Any, sample_time: float) -> Array:
    """Return a flux that moves with volt-seconds and drift, close to another observer's estimates.

    It is a start for :func:`smooth_record`: its drift and its offset are the medians of the
    estimates, so that rows before the observer settled do no harm.

    Parameters
    ----------
    flux, drift : (rows, n) array_like
        Estimates [Wb], [V].
    volt_seconds : (rows, n) array_like
        As for :meth:`RelationObserver.run`.
    sample_time : float
        [s].
    """
    estimates, v = np.asarray(flux, float), np.asarray(volt_seconds, float)
    time = sample_time * np.arange(len(v))[:, None]
    moved = np.cumsum(v, axis=0) - v[0] + time * np.median(np.asarray(drift, float), axis=0)
    return np.asarray(moved + np.median(estimates - moved, axis=0))


class SmoothedRecord(NamedTuple):
    """Estimates of a record, one row per sample.

    Attributes
    ----------
    flux, flux_std : (rows, n) ndarray
        [Wb].
    drift, drift_std : (rows, n) ndarray
        [V].
    moving, moving_std : (rows, e) ndarray
        η.
    residual : (rows, r) ndarray
        Relations at the estimate over the standard deviation that the current noise gives them.
    slope_uncertainty : float
        Mean square of the uncertainty of the relations' slopes along the direction of the flux that
        is known least, over the mean square of these slopes. Zero for a linear relation.
    """

    flux: Array
    flux_std: Array
    drift: Array
    drift_std: Array
    moving: Array
    moving_std: Array
    residual: Array
    slope_uncertainty: float

    @property
    def valid(self) -> bool:
        """Whether the standard deviations hold: the slopes are well known (:data:`LINEAR`)."""
        return self.slope_uncertainty < LINEAR


class _Row(NamedTuple):
    """What the filter knows at a row before its measurement, and the linearised measurement."""

    x: jax.Array
    P: jax.Array
    F: jax.Array  # transition to this row
    H: jax.Array
    K: jax.Array
    weight: jax.Array  # Hᵀ S⁻¹
    information: jax.Array  # Hᵀ S⁻¹ H
    residual: jax.Array


def smooth_record(
    observer: RelationObserver,
    volt_seconds: Any,
    current: Any,
    start: Any = None,
    window: int = 1,
) -> SmoothedRecord:
    """Return flux, drift and moving coefficients of every row, with their standard deviations.

    Parameters
    ----------
    observer : RelationObserver
        Relation, priors, noise and, if coefficients move, their equation of motion.
    volt_seconds, current : (rows, n) array_like
        As for :meth:`RelationObserver.run`.
    start : (rows, n) array_like, optional
        Flux of the first linearisation [Wb]; by default, that of the observer. For a quadratic
        relation, :class:`fluxobs.ImmersionObserver` gives it without a linearisation.
    window : int
        Odd number of rows over which the slopes of the relation average the current. The noise of
        the current in the slopes looks like excitation; where its share matters, choose the window
        as long as the current is smooth. The slopes are then instrumental variables: bias and
        share of the noise fall with the inverse of the window's length.

    Returns
    -------
    SmoothedRecord
        Not `valid` if the linearised problem does not describe the errors.

    Raises
    ------
    ModelError
        If shapes do not fit, or the window is not odd.
    RecordError
        If the Gauss-Newton steps do not converge: the record does not determine the flux, or its
        priors are far from the truth.
    """
    v, i = records(observer, volt_seconds, current)
    if window < 1 or window % 2 == 0:
        raise ModelError(f"window must be an odd number of rows, got {window}")
    if start is None:
        trajectory = _filter_states(observer, v, i)
    else:
        flux = real("start", start, v.shape)
        begin = observer.init().x
        rest = jnp.broadcast_to(begin[observer.n :], (len(v), len(begin) - observer.n))
        trajectory = jnp.concatenate([flux, rest], axis=1)
    change = np.inf
    for _ in range(STEPS):
        moved, P, residual, slope_uncertainty = _gauss_newton(observer, v, i, trajectory, window)
        deviation = jnp.sqrt(jnp.maximum(jnp.diagonal(P, axis1=1, axis2=2), 1e-300))
        change = float(jnp.max(jnp.abs(moved - trajectory) / deviation))
        trajectory = moved
        if not np.isfinite(change) or change < CONVERGED:
            break
    if not change < CONVERGED:
        raise RecordError(
            f"the smoother did not converge in {STEPS} steps (last change: {change:.2g} standard "
            "deviations): the record may not determine the flux, or start and priors are far off"
        )
    states = columns(np.asarray(trajectory), np.asarray(deviation), observer.n)
    return SmoothedRecord(*states, np.asarray(residual), float(slope_uncertainty))


@eqx.filter_jit
def _filter_states(observer: RelationObserver, v: jax.Array, i: jax.Array) -> jax.Array:
    """Return the states of the observer, the trajectory of the first linearisation."""

    def body(state: Any, row: tuple[jax.Array, jax.Array]) -> Any:
        state, _ = observer.step(state, *row)
        return state, state.x

    return jnp.asarray(jax.lax.scan(body, observer.init(), (v, i))[1])


@eqx.filter_jit
def _gauss_newton(
    observer: RelationObserver, v: jax.Array, i: jax.Array, trajectory: jax.Array, window: int
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Return (states, covariances, normalised residuals, slope uncertainty) after a step."""
    n, start = observer.n, observer.init()
    eye = jnp.eye(len(start.x))
    walk, variance = observer.walk(), observer.current_noise**2
    count = jax.eval_shape(observer.relation, start.x[:n], start.x[2 * n :], i[0]).shape[0]
    floor = observer.floor**2 * jnp.eye(count)

    def residual(x: jax.Array, i: jax.Array) -> jax.Array:
        return observer.relation(x[:n], x[2 * n :], i)

    def linearised(there: jax.Array, i: jax.Array) -> tuple[jax.Array, ...]:
        """Return (most probable current, residual, its covariance) at a state.

        The error of this current has no component along that of the residual.
        """
        near = i
        for _ in range(2):
            M = jax.jacfwd(residual, 1)(there, near)
            off = residual(there, near) + M @ (i - near)
            near = i - variance * M.T @ jnp.linalg.solve(variance * M @ M.T + floor, off)
        M = jax.jacfwd(residual, 1)(there, near)
        return near, residual(there, near) + M @ (i - near), variance * M @ M.T + floor

    near, off, noises = jax.vmap(linearised)(trajectory, i)
    H_rows = jax.vmap(jax.jacfwd(residual))(trajectory, _moving_mean(near, window))

    def forward(carry: Any, row: Any) -> Any:
        x, P, current, first = carry
        v, i, there, before, H, off, noise = row

        def move(state: jax.Array) -> jax.Array:
            return observer.move(state, v, current, i)

        F = jnp.where(first, eye, jax.jacfwd(move)(before))
        x = jnp.where(first, x, move(before) + F @ (x - before))
        P = F @ P @ F.T + jnp.where(first, 0.0, 1.0) * walk
        S = H @ P @ H.T + noise
        e = -off - H @ (x - there)
        weight = jnp.linalg.solve(S, H).T
        K = P @ weight
        keep = eye - K @ H
        kept = _Row(x, P, F, H, K, weight, weight @ H, e)
        after = x + K @ e, keep @ P @ keep.T + K @ noise @ K.T, i, jnp.asarray(False)
        return after, kept

    before = jnp.concatenate([trajectory[:1], trajectory[:-1]])
    carry = start.x, start.P, i[0], jnp.asarray(True)
    rows = (v, i, trajectory, before, H_rows, off, noises)
    _, kept = jax.lax.scan(forward, carry, rows)

    def backward(carry: tuple[jax.Array, jax.Array], row: _Row) -> Any:
        adjoint, information = carry
        keep = eye - row.K @ row.H
        adjoint = keep.T @ adjoint - row.weight @ row.residual
        information = keep.T @ information @ keep + row.information
        x = row.x - row.P @ adjoint
        P = row.P - row.P @ information @ row.P
        return (row.F.T @ adjoint, row.F.T @ information @ row.F), (x, P)

    zero = jnp.zeros(len(eye)), jnp.zeros(eye.shape)
    _, (states, covariances) = jax.lax.scan(backward, zero, kept, reverse=True)
    bends = jax.vmap(jax.hessian(residual))(trajectory, near)
    deviations = jnp.sqrt(jnp.diagonal(noises, axis1=1, axis2=2))
    uncertainty = _slope_uncertainty(H_rows[..., :n], bends[..., :n, :], covariances, deviations)
    return states, covariances, off / deviations, uncertainty


def _slope_uncertainty(
    slopes: jax.Array, bends: jax.Array, covariances: jax.Array, deviations: jax.Array
) -> jax.Array:
    """Return the ratio of :class:`SmoothedRecord`.

    slopes (rows, r, n) and bends (rows, r, n, states) by the flux; each relation counts in units of
    its standard deviation (rows, r).
    """
    n = slopes.shape[-1]
    weak = jnp.linalg.eigh(covariances[:, :n, :n])[1][..., -1]
    along = jnp.einsum("kri,ki->kr", slopes, weak) / deviations
    change = jnp.einsum("krij,ki->krj", bends, weak) / deviations[..., None]
    uncertain = jnp.einsum("kri,kij,krj->kr", change, covariances, change)
    return jnp.sum(uncertain) / jnp.maximum(jnp.sum(along**2), 1e-300)


def _moving_mean(rows: jax.Array, window: int) -> jax.Array:
    """Return the mean of every column over a window around each row, shorter at the ends."""
    if window == 1:
        return rows
    half = window // 2
    sums = jnp.concatenate([jnp.zeros((1, rows.shape[1])), jnp.cumsum(rows, axis=0)])
    first = jnp.maximum(jnp.arange(len(rows)) - half, 0)
    last = jnp.minimum(jnp.arange(len(rows)) + half + 1, len(rows))
    return (sums[last] - sums[first]) / (last - first)[:, None]
