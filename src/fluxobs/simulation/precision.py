"""JAX in double precision; single precision is refused at the inputs.

All that uses JAX imports this module first. It needs the extra "design" (JAX, equinox, diffrax).
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
        f"{', '.join(_missing)} not installed: this needs the extra, pip install 'fluxobs[design]'"
    )

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

#: This XLA scheduler spreads even the smallest kernels of a loop over threads. A drive simulated
#: sample by sample then takes up to 2.5 times as long, on twice the processors.
_SCHEDULER = "--xla_cpu_enable_concurrency_optimized_scheduler"
#: XLA ends the process on an unknown flag; jaxlib from the first up to the second version knows
#: this one.
_KNOWN = ((0, 4, 36), (0, 11))


def _schedule_in_sequence() -> None:
    """Turns the scheduler off unless the user has set it.

    XLA reads the flag when the first computation starts.
    """
    release = tuple(int(part) for part in version("jaxlib").split(".")[:3] if part.isdigit())
    flags = os.environ.get("XLA_FLAGS", "")
    if _KNOWN[0] <= release < _KNOWN[1] and _SCHEDULER not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {_SCHEDULER}=false".strip()


_schedule_in_sequence()
jax.config.update("jax_enable_x64", True)  # type: ignore[no-untyped-call]


def double(name: str, value: Any) -> jax.Array:
    """Array of doubles, traced or not; ModelError for single precision."""
    given = getattr(value, "dtype", None)
    if given is not None and given in (jnp.float32, jnp.float16, jnp.bfloat16, jnp.complex64):
        raise ModelError(
            f"{name} is {given}: simulation and research compute in float64 only; "
            f"give {name} as float64, e.g. numpy.asarray({name}, float)"
        )
    return jnp.asarray(value, dtype=jnp.float64)


def real(name: str, value: Any, shape: tuple[int, ...] | None = None) -> jax.Array:
    """Array of doubles; ModelError if it is of single precision, not finite or of another shape.

    For traced values only precision and shape are checked.
    """
    if not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
        raise RuntimeError("jax_enable_x64 was switched off; fluxobs needs it")
    array = double(name, value)
    if not isinstance(array, jax.core.Tracer):
        # Check with NumPy: every new operation on a JAX array costs a compilation.
        finite = np.isfinite(np.asarray(array))
        if not finite.all():
            at = tuple(int(k) for k in np.argwhere(~finite)[0])
            where = f" at {at}" if at else ""
            raise ModelError(f"{name} must be finite, got {float(array[at])}{where}")
    if shape is not None and array.shape != shape:
        raise ModelError(f"{name} must have shape {shape}, got {array.shape}")
    return array


def positive(name: str, value: Any, shape: tuple[int, ...] | None = ()) -> jax.Array:
    """Like :func:`real`; also checks that all values are above zero."""
    return _bounded(name, value, shape, "positive", lambda array: array > 0)


def not_negative(name: str, value: Any, shape: tuple[int, ...] | None = ()) -> jax.Array:
    """Like :func:`real`; also checks that no value is negative."""
    return _bounded(name, value, shape, "zero or positive", lambda array: array >= 0)


def _bounded(
    name: str, value: Any, shape: tuple[int, ...] | None, what: str, holds: Callable[[Any], Any]
) -> jax.Array:
    array = real(name, value, shape)
    if not isinstance(array, jax.core.Tracer) and not holds(np.asarray(array)).all():
        raise ModelError(f"{name} must be {what}, got {np.asarray(array).tolist()}")
    return array
