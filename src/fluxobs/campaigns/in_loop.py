"""An observer of a campaign in the loop of a simulated drive."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..observers import AdaptiveObserver
from ..simulation.drive import Drive, sensorless_drive
from ..simulation.drive.loop_observer import LoopObserver
from ..simulation.precision import real
from .drives import Cell
from .observed import Candidate

#: An open-loop start must reach a speed at which the EMF is this multiple of the voltage's standard
#: deviation: the adaptive observer starts at twice. Largest such speed as a share of the rated.
EMF_RATIO, FASTEST_START = 3.0, 0.5
#: Standard deviation at which the adaptive observer enters the loop [rad]. This standard deviation
#: includes the errors of R and inverter, several degrees at the speed of the start. The plain
#: observer's standard deviation excludes these errors; its limit is the usual, smaller value.
READY = np.pi / 18


class Reading(NamedTuple):
    """Outputs of an observer that a drive needs at a sample."""

    theta_e: Array
    speed_e: Array
    psi_f: Array
    theta_e_std: Array
    valid: Array


class AlwaysValid(eqx.Module):
    """Baseline observer, which states no standard deviation; drives trust it above a speed."""

    observer: Any
    psi_f: Array
    trusted_speed: Array

    @property
    def sample_time(self) -> Array:
        return jnp.asarray(self.observer.sample_time)

    def init(self) -> Any:
        return self.observer.init()

    def step(self, state: Any, voltage: Array, current: Array) -> tuple[Any, Reading]:
        state, estimate = self.observer.step(state, voltage, current)
        trusted = jnp.abs(estimate.speed_e) > self.trusted_speed
        angle, std = estimate.theta_e_tracked, jnp.zeros(())
        return state, Reading(angle, estimate.speed_e, self.psi_f, std, trusted)


def start_speed(observer: AdaptiveObserver, cell: Cell) -> float:
    """Return the speed to which an open-loop start must accelerate [rad/s electrical]."""
    drop = observer.resistance_std * cell.current
    voltage_std = float(np.hypot(drop, observer.inverter_std))
    return min(EMF_RATIO * voltage_std / cell.flux, FASTEST_START * cell.rated.speed_e)


def in_loop(candidate: Candidate, cell: Cell) -> Callable[[Drive], Drive]:
    """Return a function that puts an observer into the loop of a drive."""
    usual: Drive = sensorless_drive(cell.machine, cell.rated, believed=candidate.believed)
    sensorless = usual.sensorless
    assert sensorless is not None
    if candidate.adaptive:
        speed = np.maximum(sensorless.speed, start_speed(candidate.observer, cell))
        sensorless = replace(sensorless, ready=real("ready", READY), speed=real("speed", speed))
    if candidate.compiled:
        observer: Any = LoopObserver.of(candidate.observer)
    else:
        psi_f = real("psi_f", cell.flux)
        observer = AlwaysValid(candidate.observer, psi_f, real("trusted", candidate.trusted))
    return lambda drive: replace(
        drive, observer=observer, sensorless=sensorless, control=usual.control
    )
