"""Any observer in the loop of a simulated drive: compiled ones by a call out of the simulation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from ..observers.compiled import CompiledObserver, CompiledState
from ..simulation.drive import Drive, sensorless_drive
from ..simulation.precision import real
from .drives import Cell
from .observed import Candidate

#: The adaptive observer takes over at this standard deviation [rad]. Its own holds the errors of R
#: and inverter, which at the speed of the start are several degrees; the plain one's does not, so
#: that a small one is asked of it.
READY = np.pi / 18


class Seen(NamedTuple):
    """What the drive needs of an observer at a sample."""

    theta_e: Array
    speed_e: Array
    psi_f: Array
    theta_e_std: Array
    valid: Array


class _Host:
    """Compiled observers of a batch, stepped outside of the simulation; their state is here.

    Every call says which sample it is, so that one left out or repeated cannot pass unnoticed.
    """

    def __init__(self) -> None:
        self.observer: CompiledObserver[Any] | None = None
        self.state: CompiledState | None = None
        self.next = 0

    def step(self, sample: Any, voltage: Any, current: Any) -> NDArray[np.float64]:
        k, u, i = int(np.ravel(sample)[0]), np.asarray(voltage), np.asarray(current)
        assert self.observer is not None
        if k == 0:
            self.state, self.next = self.observer.init((len(i),)), 0
        if k != self.next or self.state is None:
            raise RuntimeError(f"sample {k} of a simulation came when {self.next} was due")
        self.next = k + 1
        self.state, out = self.observer.step(self.state, u, i)
        fields = (out.theta_e, out.speed_e, out.psi_f, out.theta_e_std, out.valid)
        return np.stack([np.asarray(field, float) for field in fields], axis=-1)


#: The batch that this process simulates; a compiled simulation keeps what it calls.
_HOST = _Host()


def _call(sample: Any, voltage: Any, current: Any) -> NDArray[np.float64]:
    return _HOST.step(sample, voltage, current)


class Outside(eqx.Module):
    """Stands for the compiled observer of :data:`_HOST` in a simulated drive; only in batches."""

    sample_time: Array

    def init(self) -> Array:
        return jnp.zeros((), jnp.int64)

    def step(self, sample: Array, voltage: Array, current: Array) -> tuple[Array, Seen]:
        """One sample of all lanes: voltage and current (2,) of each."""
        shape: Any = jax.eval_shape(lambda: jnp.zeros(5))
        out = jax.pure_callback(_call, shape, sample, voltage, current, vmap_method="broadcast_all")
        return sample + 1, Seen(out[0], out[1], out[2], out[3], out[4] > 0)


class Unjudged(eqx.Module):
    """An observer that steps in JAX and calls every position valid: the drive trusts it above a
    speed, as firmware does."""

    observer: Any
    psi_f: Array
    least: Array

    @property
    def sample_time(self) -> Array:
        return jnp.asarray(self.observer.sample_time)

    def init(self) -> Any:
        return self.observer.init()

    def step(self, state: Any, voltage: Array, current: Array) -> tuple[Any, Seen]:
        state, out = self.observer.step(state, voltage, current)
        trusted = jnp.abs(out.speed_e) > self.least
        zero = jnp.zeros(())
        return state, Seen(out.theta_e_tracked, out.speed_e, self.psi_f, zero, trusted)


@contextmanager
def in_loop(one: Candidate, cell: Cell) -> Iterator[Callable[[Drive], Drive]]:
    """What makes a drive of this cell sensorless: a function that puts the observer into its loop.

    One at a time: the state of a compiled observer belongs to the process.
    """
    usual: Drive = sensorless_drive(cell.machine, cell.rated, believed=one.believed)
    sensorless = usual.sensorless
    assert sensorless is not None
    if one.adaptive:
        sensorless = replace(sensorless, ready=real("ready", READY))
    if one.compiled:
        observer: Any = Outside(real("sample_time", cell.rated.sample_time))
    else:
        psi = real("psi_f", cell.machine.flux_base(cell.current))
        observer = Unjudged(one.observer, psi, real("trusted", one.trusted))
    _HOST.observer = one.observer if one.compiled else None
    try:
        yield lambda drive: replace(
            drive, observer=observer, sensorless=sensorless, control=usual.control
        )
    finally:
        _HOST.observer = _HOST.state = None
