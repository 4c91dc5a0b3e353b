"""Double precision everywhere in the design layer; single is refused where it enters."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_enable_x64", True)  # type: ignore[no-untyped-call]


def real(name: str, value: Any, shape: tuple[int, ...] | None = None) -> jax.Array:
    """Array of doubles; ValueError names what is single, not finite or of another shape.

    Traced values pass with their shape checked.
    """
    given = getattr(value, "dtype", None)
    if given is not None and given in (jnp.float32, jnp.float16, jnp.bfloat16, jnp.complex64):
        raise ValueError(
            f"{name} is {given}: the design layer computes in float64 only; "
            f"give {name} as float64, e.g. numpy.asarray({name}, float)"
        )
    if not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
        raise RuntimeError("jax_enable_x64 was switched off; the design layer needs it")
    if isinstance(value, jax.core.Tracer):
        array = value.astype(jnp.float64)
    else:
        # NumPy does the checks: every new operation on a JAX array costs a compilation.
        plain = np.asarray(value, dtype=np.float64)
        if not np.isfinite(plain).all():
            raise ValueError(f"{name} must be finite, got {plain.tolist()}")
        array = jnp.asarray(plain)
    if shape is not None and array.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {array.shape}")
    return array
