"""Running without an encoder: start, hand-over, ride-through, loss."""

from __future__ import annotations

from typing import Any, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..observers.least_squares import Reading
from ..precision import real
from .vectors import turn

Array = jax.Array

#: Modes: current vector turned without feedback (I/f), and with the observer's angle.
STARTING, RUNNING = 0, 1


class SensorlessState(NamedTuple):
    """Mode; frame in which currents are controlled, its speed [rad/s electrical]; how long the
    observer has been sure [s]; time since the start [s]; what is left of the last current step
    between modes [A, in the frame]."""

    mode: Array
    direction: Array
    speed_e: Array
    sure: Array
    running: Array
    left: Array


class Sensorless(eqx.Module):
    """Decides which angle the drive runs on.

    Starting (I/f): a current of `current` turns with the reference speed, at most `speed`, after
    `align` seconds at rest. The observer takes over when its standard deviation has been below
    `ready` for `hold` seconds. It goes on through a reversal, where it carries the flux by
    integration, as long as its standard deviation stays below `lost`; then the drive says that it
    is lost and goes back to starting, at the speed it had.

    Parameters
    ----------
    current : float
        [A peak]; must carry the load.
    speed : float
        Fastest without feedback [rad/s electrical].
    acceleration : float
        [rad/s² electrical].
    align, hold, blend : float
        [s]; `blend` is the time constant with which currents change at hand-over.
    ready, lost : float
        Standard deviations of the angle [rad]; 5 and 30 degrees.
    """

    current: Array
    speed: Array
    acceleration: Array
    align: Array
    hold: Array
    blend: Array
    ready: Array
    lost: Array

    def __init__(
        self,
        current: Any,
        speed: Any,
        acceleration: Any,
        align: Any = 0.1,
        hold: Any = 0.02,
        blend: Any = 0.02,
        ready: Any = np.pi / 36,
        lost: Any = np.pi / 6,
    ) -> None:
        for name, value in (
            ("current", current),
            ("speed", speed),
            ("acceleration", acceleration),
            ("align", align),
            ("hold", hold),
            ("blend", blend),
            ("ready", ready),
            ("lost", lost),
        ):
            setattr(self, name, real(name, value))

    @classmethod
    def for_drive(cls, current_limit: float, rated_speed_e: float, **given: Any) -> Self:
        """The whole current, up to a tenth of the rated speed within half a second."""
        given.setdefault("current", current_limit)
        given.setdefault("speed", 0.1 * rated_speed_e)
        given.setdefault("acceleration", 0.2 * rated_speed_e)
        return cls(**given)

    def init(self) -> SensorlessState:
        zero = jnp.zeros(())
        one = jax.lax.complex(jnp.ones(()), zero)
        # The current comes in as gently as at a hand-over.
        return SensorlessState(jnp.asarray(STARTING), one, zero, zero, zero, -self.current * one)

    def step(
        self,
        state: SensorlessState,
        reading: Reading,
        reference_e: Array,
        current: Array,
        sample_time: Array,
    ) -> tuple[SensorlessState, Array, Array, Array]:
        """Frame and speed for this sample.

        Returns
        -------
        state, direction, speed_e
        turned : complex
            New frame seen from the old one where the mode changed, else 1.
        """
        h = sample_time
        sure = jnp.where(reading.theta_e_std < self.ready, state.sure + h, 0.0)
        was_running = state.mode == RUNNING
        takes_over = ~was_running & (sure >= self.hold) & (state.running >= self.align)
        loses = was_running & ~(reading.theta_e_std < self.lost)
        running = (was_running | takes_over) & ~loses
        # Without feedback: the frame turns towards the reference speed.
        aim = jnp.where(state.running < self.align, 0.0, reference_e)
        aim = jnp.clip(aim, -self.speed, self.speed)
        most = self.acceleration * h
        open_speed = state.speed_e + jnp.clip(aim - state.speed_e, -most, most)
        open_direction = state.direction * turn(h * state.speed_e)
        # Lost: the frame goes on from the current vector, so that the torque does.
        size = jnp.sqrt(current.real**2 + current.imag**2)
        along = current / jnp.maximum(size, 1e-300)
        open_direction = jnp.where(loses & (size > 0.05 * self.current), along, open_direction)
        direction = jnp.where(running, turn(reading.theta_e), open_direction)
        speed_e = jnp.where(running, reading.speed_e, open_speed)
        changed = takes_over | loses
        before = state.direction * turn(h * state.speed_e)
        turned = jnp.where(changed, direction * jnp.conj(before), 1.0)
        state = SensorlessState(
            jnp.where(running, RUNNING, STARTING),
            direction,
            speed_e,
            sure,
            state.running + h,
            state.left * jnp.exp(-h / self.blend),
        )
        return state, direction, speed_e, turned
