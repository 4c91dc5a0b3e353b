"""Code shared by the observers on the regression: continuous form, sampled form, and runner.

``derivative(state, y_m, row)`` is the published law for an ODE solver. ``step(state, h,
volt_seconds, row)`` processes one sample: it advances the state by the known volt-seconds, then
applies the exact solution of the gradient flow for a constant regressor. This step is stable at any
gain, even if the law is stiff.
"""

from __future__ import annotations

from typing import Any, Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ....errors import ModelError
from ....simulation.precision import real
from ....simulation.runge_kutta import Place, runge_kutta_step
from .. import Regressors


class FluxObserver(Protocol):
    """Observer with constant parameters and explicit state."""

    def init(self) -> Any: ...

    def step(self, state: Any, h: float, volt_seconds: jax.Array, row: Regressors) -> Any: ...

    def estimate(self, state: Any) -> tuple[jax.Array, jax.Array]:
        """Return flux (n,) and estimated constants (n_θ,); n_θ may be zero."""
        ...


class ContinuousObserver(FluxObserver, Protocol):
    """Observer published as a differential equation."""

    def derivative(self, state: Any, y_m: jax.Array, row: Regressors) -> Any: ...


def positive_definite(name: str, value: Any, size: int) -> jax.Array:
    """Return a gain matrix of this size from a number, a vector (the diagonal) or a matrix.

    Raises
    ------
    ModelError
        If the matrix is not symmetric positive definite. The message gives its smallest eigenvalue.
    """
    gain = np.asarray(real(name, value))
    if gain.shape not in ((), (size,), (size, size)):
        raise ModelError(
            f"{name} must be a number, ({size},) or ({size}, {size}), got {gain.shape}"
        )
    if gain.ndim < 2:
        gain = gain * np.eye(size)
    if not np.allclose(gain, gain.T, rtol=1e-12, atol=0):
        raise ModelError(f"{name} must be symmetric, got {gain.tolist()}")
    # Check per-unit values: the scales of flux and constants differ by twenty powers of ten.
    scale = np.sqrt(np.abs(np.diag(gain)))
    smallest = np.linalg.eigvalsh(gain / np.outer(scale, scale)).min() if scale.all() else 0.0
    if not (smallest > 0 and (np.diag(gain) > 0).all()):
        raise ModelError(
            f"{name} must be positive definite, got smallest eigenvalue {smallest:g} "
            "after scaling its diagonal to one"
        )
    return jnp.asarray(gain)


def flow_gain(q: jax.Array, h: float) -> jax.Array:
    """Return ``(1 - e^{-qh})/q``, the effect of a gradient flow of rate q over h (h for q = 0)."""
    safe = jnp.where(q > 0, q, 1.0)
    return jnp.where(q > 0, -jnp.expm1(-safe * h) / safe, h)


@eqx.filter_jit
def run(
    observer: FluxObserver, h: float, volt_seconds: jax.Array, rows: Regressors, skip: Any = 0
) -> tuple[jax.Array, jax.Array]:
    """Return (flux (rows, n), constants (rows, n_θ)) over a record, starting at `observer.init()`.

    Row k's volt-seconds belong to the interval that ends at row k. The first `skip` rows, the
    transient of the filters, do not use the regression.
    """
    count = len(rows.y)

    def body(state: Any, sample: Any) -> tuple[Any, Any]:
        k, v, row = sample
        use = jnp.where(k >= skip, 1.0, 0.0)
        row = Regressors(*(use * entry for entry in row))
        state = observer.step(state, h, jnp.where(k > 0, v, 0.0), row)
        return state, observer.estimate(state)

    samples = (jnp.arange(count), volt_seconds, rows)
    _, estimates = jax.lax.scan(body, observer.init(), samples)
    return estimates  # type: ignore[no-any-return]


@eqx.filter_jit
def integrate_law(
    observer: ContinuousObserver, h: float, y_m: jax.Array, rows: Regressors
) -> tuple[jax.Array, jax.Array]:
    """Integrate the law's differential equation by Runge-Kutta (order 4); return (flux, constants).

    The law must not be stiff: h times its rate must be below one. The results have the shapes
    (steps + 1, n) and (steps + 1, n_θ); they start at `observer.init()`.

    Parameters
    ----------
    observer : ContinuousObserver
    h : float
        Step [s].
    y_m : (2 steps + 1, n) array
        Values at every half step.
    rows : Regressors
        Rows at every half step.
    """

    def body(state: Any, k: jax.Array) -> tuple[Any, Any]:
        def rate(state: Any, place: Place) -> Any:
            at = 2 * k + place
            return observer.derivative(
                state, y_m[at], Regressors(*(entries[at] for entries in rows))
            )

        state = runge_kutta_step(rate, state, h)
        return state, observer.estimate(state)

    start = observer.init()
    _, estimates = jax.lax.scan(body, start, jnp.arange((len(y_m) - 1) // 2))
    return jax.tree.map(  # type: ignore[no-any-return]
        lambda first, later: jnp.concatenate([first[None], later]),
        observer.estimate(start),
        estimates,
    )
