"""Running without an encoder: start, hand-over, ride-through, loss."""

from __future__ import annotations

from typing import Any, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..precision import real
from .loop_observer import Reading
from .vectors import length, turn, unit

#: Modes: open-loop rotation of the current vector (I/f), and control with the observer's angle.
STARTING, RUNNING = 0, 1


class SensorlessState(NamedTuple):
    """Mode; frame of current control, and its speed [rad/s electrical]; how long the observer has
    been ready, and how long not valid [s]; time since the start [s]; remainder of the last current
    step between modes [A, in the frame]."""

    mode: Array
    direction: Array
    speed_e: Array
    sure: Array
    unsure: Array
    running: Array
    left: Array


class Sensorless(eqx.Module):
    """Decides which angle the drive runs on.

    Start (I/f): after `align` seconds at rest a current vector of length `current` turns at the
    reference speed, at most at `speed`. The observer takes over once its position has been valid,
    with a standard deviation below `ready`, for `hold` seconds, and the reference is not zero. If
    the position becomes invalid, as near zero speed, the drive rides through for `ride` seconds.
    After that, or once the standard deviation reaches `lost`, the position counts as lost, and the
    drive returns to I/f at its present speed.

    Parameters
    ----------
    current : float
        Peak current during the start [A]; must carry the load.
    speed : float
        Largest open-loop speed [rad/s electrical].
    acceleration : float
        Open-loop acceleration [rad/s² electrical].
    align, hold, blend, ride : float
        Times as above [s]; `blend` is the time constant of the current at hand-over.
    ready, lost : float
        Limits for the standard deviation of the angle [rad]; 2 and 30 degrees.
    """

    current: Array
    speed: Array
    acceleration: Array
    align: Array
    hold: Array
    blend: Array
    ride: Array
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
        ride: Any = 0.15,
        ready: Any = np.pi / 90,
        lost: Any = np.pi / 6,
    ) -> None:
        for name, value in (
            ("current", current),
            ("speed", speed),
            ("acceleration", acceleration),
            ("align", align),
            ("hold", hold),
            ("blend", blend),
            ("ride", ride),
            ("ready", ready),
            ("lost", lost),
        ):
            setattr(self, name, real(name, value))

    @classmethod
    def for_drive(cls, current_limit: float, rated_speed_e: float, **given: Any) -> Self:
        """Starts at the current limit, up to a tenth of the rated speed within half a second."""
        given.setdefault("current", current_limit)
        given.setdefault("speed", 0.1 * rated_speed_e)
        given.setdefault("acceleration", 0.2 * rated_speed_e)
        return cls(**given)

    def init(self) -> SensorlessState:
        zero = jnp.zeros(())
        one = jax.lax.complex(jnp.ones(()), zero)
        # The current rises with the same time constant as at a hand-over.
        start = -self.current * one
        return SensorlessState(jnp.asarray(STARTING), one, zero, zero, zero, zero, start)

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
        changed : bool
            Whether the frame jumps at this sample.
        """
        h = sample_time
        good = reading.valid & (reading.theta_e_std < self.ready)
        sure = jnp.where(good, state.sure + h, 0.0)
        unsure = jnp.where(reading.valid, 0.0, state.unsure + h)
        was_running = state.mode == RUNNING
        # At a standstill reference the position would be lost again at once.
        moves = jnp.abs(reference_e) > 1e-3 * self.speed
        takes_over = ~was_running & moves & (sure >= self.hold) & (state.running >= self.align)
        loses = was_running & (~(reading.theta_e_std < self.lost) | (unsure > self.ride))
        running = (was_running | takes_over) & ~loses
        # Open loop: the speed of the frame ramps towards the reference.
        aim = jnp.where(state.running < self.align, 0.0, reference_e)
        aim = jnp.clip(aim, -self.speed, self.speed)
        most = self.acceleration * h
        open_speed = state.speed_e + jnp.clip(aim - state.speed_e, -most, most)
        open_direction = state.direction * turn(h * state.speed_e)
        # Lost: the frame starts from the current vector, so that the torque stays continuous.
        follows = loses & (length(current) > 0.05 * self.current)
        open_direction = jnp.where(follows, unit(current), open_direction)
        direction = jnp.where(running, turn(reading.theta_e), open_direction)
        speed_e = jnp.where(running, reading.speed_e, open_speed)
        state = SensorlessState(
            jnp.where(running, RUNNING, STARTING),
            direction,
            speed_e,
            sure,
            unsure,
            state.running + h,
            state.left * jnp.exp(-h / self.blend),
        )
        return state, direction, speed_e, takes_over | loses
