"""Observer for any relation between flux and current: an extended Kalman filter.

The immersion of the paper's quadratic relations is exact, but not every machine has such a
relation. This observer accepts any relation ``h(λ, η, i) = 0`` written in JAX and linearises it at
the estimate:

* Relations linear in λ with coefficients in i (switched reluctance); the filter is then exact.
* Relations in features such as ``-ln(1 - λ/ψ_s)`` (saturation), or of any degree.
* Relations with moving coefficients η that have their own equation (the rotor flux of an induction
  machine obeys ``η' = -α η + R_R i_d``).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..core.arrays import Array
from ..errors import ModelError
from ..simulation.precision import not_negative, positive, real

Relation = Callable[[jax.Array, jax.Array, jax.Array], jax.Array]
Motion = Callable[[jax.Array, jax.Array, jax.Array], jax.Array]


class RelationState(NamedTuple):
    """Estimate (λ, θ, η), its covariance, and the last current."""

    x: jax.Array
    P: jax.Array
    current: jax.Array


class RelationEstimate(NamedTuple):
    """Estimates, one row per sample.

    Attributes
    ----------
    flux, flux_std : (rows, n) ndarray
        [Wb].
    drift, drift_std : (rows, n) ndarray
        [V].
    moving, moving_std : (rows, e) ndarray
        η.
    innovation : (rows, r) ndarray
        Residual of the relations over its standard deviation.
    """

    flux: Array
    flux_std: Array
    drift: Array
    drift_std: Array
    moving: Array
    moving_std: Array
    innovation: Array


class RelationObserver(eqx.Module):
    """Kalman filter for flux, drift and the moving coefficients of the relations.

    Parameters
    ----------
    relation : callable
        Function ``h(flux (n,), eta (e,), current (n,))`` → residuals (r,), written in jax.numpy.
        The residuals are zero at the truth.
    n : int
        Number of ports.
    sample_time : float
        [s].
    flux_prior, drift_prior : (n,) array_like
        Standard deviations at the start [Wb], [V].
    current_noise, voltage_noise : float
        Standard deviation of a current [A] and of the mean voltage over a sample [V]. The slope of
        the relations converts the current noise into the noise of the residuals.
    drift_walk : float
        Growth of the drift's standard deviation [V/√s]; 0 for constant offsets.
    start : (n,) array_like, optional
        Flux at the start [Wb]; default zero. Nonlinear relations are linearised at this flux.
    moving : (e,) array_like, optional
        η at the start; default empty.
    moving_prior : (e,) array_like, optional
        Standard deviation of η at the start.
    motion : callable, optional
        Function in ``η' = motion(flux, eta, current)``; by default, η is constant.
    floor : float
        Standard deviation of the relation's own error, in the unit of the residuals; it is always
        added. It keeps the filter regular if there is no noise.
    iterations : int
        Linearisations per sample; use more than one for relations that bend within the prior.

    Raises
    ------
    ModelError
        If a number is out of range or the relation does not fit its arguments.
    """

    relation: Relation
    motion: Motion | None
    n: int = eqx.field(static=True)
    sample_time: jax.Array
    flux_prior: jax.Array
    drift_prior: jax.Array
    current_noise: jax.Array
    voltage_noise: jax.Array
    drift_walk: jax.Array
    begin: jax.Array
    moving: jax.Array
    moving_prior: jax.Array
    floor: jax.Array
    iterations: int = eqx.field(static=True)

    def __init__(
        self,
        relation: Relation,
        n: int,
        sample_time: float,
        flux_prior: Any,
        drift_prior: Any,
        current_noise: float,
        voltage_noise: float = 0.0,
        drift_walk: float = 0.0,
        start: Any = None,
        moving: Any = (),
        moving_prior: Any = (),
        motion: Motion | None = None,
        floor: float = 1e-9,
        iterations: int = 1,
    ) -> None:
        self.relation, self.motion, self.n = relation, motion, n
        self.sample_time = positive("sample_time", sample_time)
        self.flux_prior = positive("flux_prior", np.broadcast_to(flux_prior, (n,)), (n,))
        self.drift_prior = positive("drift_prior", np.broadcast_to(drift_prior, (n,)), (n,))
        self.current_noise = not_negative("current_noise", current_noise)
        self.voltage_noise = not_negative("voltage_noise", voltage_noise)
        self.drift_walk = not_negative("drift_walk", drift_walk)
        self.floor = positive("floor", floor)
        if iterations < 1:
            raise ModelError(f"iterations must be at least 1, got {iterations}")
        self.iterations = int(iterations)
        self.begin = real("start", np.zeros(n) if start is None else start, (n,))
        self.moving = real("moving", np.asarray(moving, float))
        self.moving_prior = not_negative("moving_prior", np.asarray(moving_prior, float), None)
        if self.moving.ndim != 1 or self.moving_prior.shape != self.moving.shape:
            raise ModelError(
                f"moving and moving_prior must have one shape (e,), got {self.moving.shape} and "
                f"{self.moving_prior.shape}"
            )
        shape = jax.eval_shape(relation, self.begin, self.moving, jnp.zeros(n)).shape
        if len(shape) != 1:
            raise ModelError(f"the relation must return residuals (r,), got shape {shape}")

    def init(self) -> RelationState:
        n = self.n
        x = jnp.concatenate([self.begin, jnp.zeros(n), self.moving])
        P = jnp.diag(jnp.concatenate([self.flux_prior, self.drift_prior, self.moving_prior]) ** 2)
        return RelationState(x, P, jnp.full(n, jnp.nan))

    def move(
        self, x: jax.Array, volt_seconds: jax.Array, before: jax.Array, current: jax.Array
    ) -> jax.Array:
        """Return the state (λ, θ, η) one sample later; `before` and `current` are its currents."""
        n, h = self.n, self.sample_time
        flux, drift, eta = x[:n], x[n : 2 * n], x[2 * n :]
        after = flux + volt_seconds + h * drift
        if self.motion is not None:
            rate = self.motion(flux, eta, before)
            ahead = self.motion(after, eta + h * rate, current)
            eta = eta + h * (rate + ahead) / 2  # Heun
        return jnp.concatenate([after, drift, eta])

    def walk(self) -> jax.Array:
        """Return the covariance that a sample adds: voltage noise and walk of the drift."""
        n, h = self.n, self.sample_time
        return jnp.diag(
            jnp.concatenate(
                [
                    jnp.full(n, (h * self.voltage_noise) ** 2),
                    jnp.full(n, h * self.drift_walk**2),
                    jnp.zeros(len(self.moving)),
                ]
            )
        )

    def step(
        self, state: RelationState, volt_seconds: jax.Array, current: jax.Array
    ) -> tuple[RelationState, jax.Array]:
        """Process one sample.

        Parameters
        ----------
        state : RelationState
        volt_seconds : (n,) array
            ∫ (-R i_m + B u_m) dt over the interval that ends now [Wb].
        current : (n,) array
            Measured current [A].

        Returns
        -------
        state : RelationState
        innovation : (r,) array
            Residual of the relations over its standard deviation.
        """
        n = self.n
        begun = jnp.isfinite(state.current).all()
        before = jnp.where(begun, state.current, current)

        def move(x: jax.Array) -> jax.Array:
            return jnp.where(begun, self.move(x, volt_seconds, before, current), x)

        F = jax.jacfwd(move)(state.x)
        x = move(state.x)
        P = F @ state.P @ F.T + jnp.where(begun, 1.0, 0.0) * self.walk()

        def residual(x: jax.Array, i: jax.Array) -> jax.Array:
            return self.relation(x[:n], x[2 * n :], i)

        def update(there: jax.Array, _: Any) -> tuple[jax.Array, Any]:
            """Linearise at `there`; do a Gauss-Newton step on prediction and relation together."""
            H, by_current = jax.jacfwd(residual, (0, 1))(there, current)
            noise = self.current_noise**2 * by_current @ by_current.T
            noise = noise + self.floor**2 * jnp.eye(len(by_current))
            S = H @ P @ H.T + noise
            K = jnp.linalg.solve(S, H @ P).T
            r = residual(there, current) + H @ (x - there)
            return x - K @ r, (H, K, noise, r / jnp.sqrt(jnp.diag(S)))

        there, passes = jax.lax.scan(update, x, None, length=self.iterations)
        H, K, noise, _ = (values[-1] for values in passes)
        # Joseph's form keeps P positive semi-definite.
        keep = jnp.eye(len(x)) - K @ H
        after = RelationState(there, keep @ P @ keep.T + K @ noise @ K.T, current)
        return after, passes[3][0]

    def run(self, volt_seconds: Any, current: Any) -> RelationEstimate:
        """Process the currents of a record and the volt-seconds before each row, both (rows, n)."""
        v, i = records(self, volt_seconds, current)
        x, P, innovation = (np.asarray(values) for values in _run(self, v, i))
        return RelationEstimate(*columns(x, np.sqrt(np.maximum(P, 0.0)), self.n), innovation)


def columns(x: Array, std: Array, n: int) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Return flux, drift and η, each with its standard deviation, of states (rows, 2n + e)."""
    parts = (slice(0, n), slice(n, 2 * n), slice(2 * n, None))
    flux, drift, moving = ((x[:, part], std[:, part]) for part in parts)
    return *flux, *drift, *moving


def records(
    observer: RelationObserver, volt_seconds: Any, current: Any
) -> tuple[jax.Array, jax.Array]:
    """Return volt-seconds and currents (rows, n) as arrays, or raise ModelError."""
    v, i, n = real("volt_seconds", volt_seconds), real("current", current), observer.n
    if v.shape != i.shape or v.ndim != 2 or v.shape[1] != n:
        raise ModelError(
            f"volt_seconds and current must be (rows, {n}), got {v.shape} and {i.shape}"
        )
    return v, i


@eqx.filter_jit
def _run(
    observer: RelationObserver, v: jax.Array, i: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    def body(state: RelationState, row: tuple[jax.Array, jax.Array]) -> Any:
        state, innovation = observer.step(state, *row)
        return state, (state.x, jnp.diag(state.P), innovation)

    return jax.lax.scan(body, observer.init(), (v, i))[1]  # type: ignore[no-any-return]
