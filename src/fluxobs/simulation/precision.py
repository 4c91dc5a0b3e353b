"""JAX in double precision; inputs in single precision raise an error.

Every module with JAX imports this module first. It needs the extra "design" (JAX, equinox,
diffrax).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any

from ..errors import FluxobsError, ModelError

_missing = [name for name in ("jax", "equinox", "diffrax") if find_spec(name) is None]
if _missing:
    raise FluxobsError(
        f"{', '.join(_missing)} not installed: install the extra with pip install 'fluxobs[design]'"
    )

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

#: XLA scheduler that distributes even the smallest kernels of a loop over threads. A drive
#: simulated sample by sample then needs up to 2.5 times the time and twice the processors.
_SCHEDULER = "--xla_cpu_enable_concurrency_optimized_scheduler"
#: First version of jaxlib with this flag; first version without it. XLA aborts on unknown flags.
_SUPPORTED = ((0, 4, 36), (0, 11))


def _disable_scheduler() -> None:
    """Turn the scheduler off unless the user has set it.

    XLA reads the flag when the first computation starts.
    """
    release = tuple(int(part) for part in version("jaxlib").split(".")[:3] if part.isdigit())
    flags = os.environ.get("XLA_FLAGS", "")
    if _SUPPORTED[0] <= release < _SUPPORTED[1] and _SCHEDULER not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {_SCHEDULER}=false".strip()


_disable_scheduler()
jax.config.update("jax_enable_x64", True)  # type: ignore[no-untyped-call]


def double(name: str, value: Any) -> jax.Array:
    """Return an array of doubles, traced or not; raise ModelError if it has single precision."""
    dtype = getattr(value, "dtype", None)
    if dtype is not None and dtype in (jnp.float32, jnp.float16, jnp.bfloat16, jnp.complex64):
        raise ModelError(
            f"{name} is {dtype}: simulation and research compute in float64 only; "
            f"give {name} as float64, e.g. numpy.asarray({name}, float)"
        )
    return jnp.asarray(value, dtype=jnp.float64)


def real(name: str, value: Any, shape: tuple[int, ...] | None = None) -> jax.Array:
    """Return an array of doubles; raise ModelError if precision, shape or a value is invalid.

    Traced values are checked only for precision and shape.
    """
    if not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
        raise RuntimeError("jax_enable_x64 is off, but fluxobs needs it: switch it on")
    array = double(name, value)
    if not isinstance(array, jax.core.Tracer):
        # Check with NumPy, because every new operation on a JAX array needs a compilation.
        finite = np.isfinite(np.asarray(array))
        if not finite.all():
            index = tuple(int(k) for k in np.argwhere(~finite)[0])
            where = f" at {index}" if index else ""
            raise ModelError(f"{name} must be finite, got {float(array[index])}{where}")
    if shape is not None and array.shape != shape:
        raise ModelError(f"{name} must have shape {shape}, got {array.shape}")
    return array


def positive(name: str, value: Any, shape: tuple[int, ...] | None = ()) -> jax.Array:
    """Return an array like :func:`real`; raise ModelError unless all values are above zero."""
    return _check_bound(name, value, shape, "positive", lambda array: array > 0)


def not_negative(name: str, value: Any, shape: tuple[int, ...] | None = ()) -> jax.Array:
    """Return an array like :func:`real`; raise ModelError if a value is negative."""
    return _check_bound(name, value, shape, "zero or positive", lambda array: array >= 0)


def _check_bound(
    name: str, value: Any, shape: tuple[int, ...] | None, bound: str, holds: Callable[[Any], Any]
) -> jax.Array:
    array = real(name, value, shape)
    if not isinstance(array, jax.core.Tracer) and not holds(np.asarray(array)).all():
        raise ModelError(f"{name} must be {bound}, got {np.asarray(array).tolist()}")
    return array
