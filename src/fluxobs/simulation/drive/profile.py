"""Piecewise-linear functions of time, for references, loads, biases and the DC link."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...errors import ModelError
from ..precision import real


class Profile(eqx.Module):
    """Linear interpolation between knots; constant before the first knot and after the last knot.

    Two knots at the same time are a jump.

    Parameters
    ----------
    times : (k,) array_like
        Times of the knots [s], not decreasing.
    values : (k,) or (k, 2) array_like
        Values at the knots, in SI units.

    Examples
    --------
    >>> ramp = Profile([0.0, 1.0], [0.0, 100.0])
    >>> float(ramp.at(jnp.asarray(0.25)))
    25.0
    """

    times: jax.Array
    values: jax.Array

    def __init__(self, times: Any, values: Any) -> None:
        self.times, self.values = real("times", times), real("values", values)
        shape = self.values.shape
        if (
            self.times.ndim != 1
            or len(self.times) == 0
            or len(shape) not in (1, 2)
            or shape[0] != len(self.times)
            or shape[1:] not in ((), (2,))
        ):
            raise ModelError(
                f"a profile needs one value per time, a number or a pair (α, β); got shapes "
                f"{self.values.shape} and {self.times.shape}"
            )
        if not isinstance(self.times, jax.core.Tracer):
            decreases = np.flatnonzero(np.diff(np.asarray(self.times)) < 0)
            if len(decreases):
                raise ModelError(
                    f"times must not decrease, got {self.times[decreases[0]]:g} s before "
                    f"{self.times[decreases[0] + 1]:g} s"
                )

    @classmethod
    def of(cls, value: Any) -> Profile:
        """Return a profile unchanged, or a constant profile from a number or a vector."""
        return value if isinstance(value, Profile) else cls([0.0], real("value", value)[None])

    def at(self, t: jax.Array) -> jax.Array:
        """Return the values (...) or (..., 2) at the times t (...)."""
        after = jnp.searchsorted(self.times, t, side="right")
        low = jnp.maximum(after - 1, 0)
        high = jnp.minimum(after, len(self.times) - 1)
        span = self.times[high] - self.times[low]  # zero outside the knots
        share = (t - self.times[low]) / jnp.where(span > 0, span, 1.0)
        if self.values.ndim == 2:
            share = share[..., None]
        return self.values[low] + share * (self.values[high] - self.values[low])
