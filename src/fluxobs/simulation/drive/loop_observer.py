"""A compiled observer in the loop of a simulated drive: XLA calls the C of the firmware.

The handler is part of the compiled modules (``binding/xla.cpp``) and needs neither a compiler nor
jaxlib at build time. A simulation calls the handler once per sample for all drives of a batch.
State and parameters are arrays of bytes, so that the handler works within ``jit``, ``vmap`` and
``scan``. The handler has no derivative.
"""

from __future__ import annotations

from functools import cache
from types import ModuleType
from typing import Any, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ... import _core, _core_single
from ...observers import AdaptiveObserver, Estimate, LeastSquaresObserver
from ..precision import real

#: Precision → compiled module.
MODULES: dict[str, ModuleType] = {"double": _core, "single": _core_single}


class Reading(NamedTuple):
    """Estimate of one sample with the fields of :class:`fluxobs.observers.Estimate`.

    The adaptive observer's `psi_f` is its estimate of the magnet flux.
    """

    flux: Array
    psi_f: Array
    theta_e: Array
    theta_e_tracked: Array
    speed_e: Array
    drift: Array
    theta_e_std: Array
    valid: Array
    innovation: Array
    noise_share: Array


class LoopObserver(eqx.Module):
    """A plain or adaptive observer for :class:`Drive`; its numbers equal the compiled observer's.

    Create it with :meth:`of`. An object with stacked leaves is a batch of observers for a batch of
    machines.

    Examples
    --------
    >>> from fluxobs import LeastSquaresObserver
    >>> from fluxobs.machines import example
    >>> compiled = LeastSquaresObserver.for_machine(example("servo-400w"), sample_time=1e-4)
    >>> observer = LoopObserver.of(compiled)
    >>> state, reading = observer.step(observer.init(), jnp.zeros(2), jnp.array([0.1, 0.0]))
    >>> bool(reading.valid)
    False
    """

    parameters: Array  # (bytes,) uint8
    initial_state: Array  # (bytes,) uint8
    sample_time: Array
    adaptive: bool = eqx.field(static=True)
    precision: str = eqx.field(static=True)

    @classmethod
    def of(cls, observer: LeastSquaresObserver | AdaptiveObserver) -> Self:
        """Return the observer for the loop, in its own precision; most firmware uses "single"."""
        plain = observer.plain if isinstance(observer, AdaptiveObserver) else observer
        return cls(
            parameters=jnp.asarray(observer._core.image()),
            initial_state=jnp.asarray(observer._core.reset(1)[0]),
            sample_time=real("sample_time", plain.sample_time),
            adaptive=isinstance(observer, AdaptiveObserver),
            precision=plain.precision,
        )

    def init(self) -> Array:
        """Return the state before the first sample."""
        return self.initial_state

    def step(self, state: Array, voltage: Array, current: Array) -> tuple[Array, Reading]:
        """Process a sample: mean voltage [V] over the interval ending now and current [A] now."""
        columns = _columns(self.precision, self.adaptive)
        count = sum(components for _, components in columns) + 1
        shapes = (
            _shape(state.shape, jnp.uint8),
            _shape((*state.shape[:-1], count), jnp.float64),
        )
        call = jax.ffi.ffi_call(
            _target(self.precision, self.adaptive),
            shapes,
            vmap_method="expand_dims",
            input_output_aliases={1: 0},
        )
        state, numbers = call(self.parameters, state, voltage, current)
        values: dict[str, Array] = {"valid": numbers[..., -1] > 0}
        first = 0
        for name, components in columns:
            values[name] = (
                numbers[..., first] if components == 1 else numbers[..., first : first + components]
            )
            first += components
        return state, Reading(**{name: values[name] for name in Reading._fields})

    def run(self, voltage: Any, current: Any) -> Estimate:
        """Process a record of voltages (rows, 2) and currents (rows, 2) from the initial state.

        Row k's voltage is the mean over the interval that ends at row k.
        """
        reading = _run(self, jnp.asarray(voltage, float), jnp.asarray(current, float))
        return Estimate(**{name: np.asarray(value) for name, value in reading._asdict().items()})


def _shape(shape: tuple[int, ...], dtype: Any) -> Any:
    struct: Any = jax.ShapeDtypeStruct
    return struct(shape, dtype)


@eqx.filter_jit
def _run(observer: LoopObserver, voltage: Array, current: Array) -> Reading:
    def body(state: Array, row: tuple[Array, Array]) -> Any:
        return observer.step(state, *row)

    return jax.lax.scan(body, observer.init(), (voltage, current))[1]  # type: ignore[no-any-return]


@cache
def _target(precision: str, adaptive: bool) -> str:
    """Return the name under which XLA knows the observer's step; register it once per process."""
    module = MODULES[precision]
    name = f"fluxobs_{'adaptive_' if adaptive else ''}step_{precision}"
    handler = module.xla_adaptive_step if adaptive else module.xla_step
    jax.ffi.register_ffi_target(name, handler, platform="cpu")
    return name


def _columns(precision: str, adaptive: bool) -> list[tuple[str, int]]:
    """Return (name, components) of the columns that the step writes."""
    module = MODULES[precision]
    columns: list[tuple[str, int]] = module.adaptive_outputs if adaptive else module.outputs
    return columns
