"""Operation without an encoder: start, hand-over, ride-through, loss of position."""

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

#: Modes: open-loop rotation of the current vector (I/f); control with the observer's angle.
STARTING, RUNNING = 0, 1


class SensorlessState(NamedTuple):
    """Mode, frame and timers of a drive without an encoder."""

    mode: Array  # STARTING or RUNNING.
    direction: Array  # Frame of the current control.
    speed_e: Array  # Speed of the frame [rad/s electrical].
    ready_time: Array  # Time for which the observer has been ready [s].
    invalid_time: Array  # Time for which the position has been invalid [s].
    run_time: Array  # Time since the start [s].
    transient: Array  # Rest of the current step at the last hand-over [A, in the frame].


class Sensorless(eqx.Module):
    """Choice between open-loop start and control with the observer's angle.

    At the start (I/f), after `align` seconds at rest, a current vector of length `current` turns at
    the reference speed, but at most at `speed`. The drive then uses the observer's angle if the
    observer's position has been valid for `hold` seconds with a standard deviation below `ready`
    and the reference is not zero. If the position becomes invalid, for example near zero speed, the
    drive continues for `ride` seconds. After this time, or if the standard deviation reaches
    `lost`, the position counts as lost and the drive returns to I/f at its present speed.

    Parameters
    ----------
    current : float
        Peak current during the start [A]; it must carry the load.
    speed : float
        Largest open-loop speed [rad/s electrical].
    acceleration : float
        Open-loop acceleration [rad/s² electrical].
    align, hold, blend, ride : float
        Times [s] as described above; `blend` is the time constant of the current at hand-over.
    ready, lost : float
        Limits for the standard deviation of the angle [rad]; the defaults are 2 and 30 degrees.
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
    def for_drive(cls, current_limit: float, rated_speed_e: float, **options: Any) -> Self:
        """Create a start at the current limit, to 0.1 of the rated speed within half a second."""
        options.setdefault("current", current_limit)
        options.setdefault("speed", 0.1 * rated_speed_e)
        options.setdefault("acceleration", 0.2 * rated_speed_e)
        return cls(**options)

    def init(self) -> SensorlessState:
        zero = jnp.zeros(())
        along_alpha = jax.lax.complex(jnp.ones(()), zero)
        # The current rises with the time constant of a hand-over.
        transient = -self.current * along_alpha
        return SensorlessState(
            jnp.asarray(STARTING), along_alpha, zero, zero, zero, zero, transient
        )

    def step(
        self,
        state: SensorlessState,
        reading: Reading,
        reference_e: Array,
        current: Array,
        sample_time: Array,
    ) -> tuple[SensorlessState, Array, Array, Array]:
        """Return the frame and its speed for this sample.

        Returns
        -------
        state, direction, speed_e
        changed : bool
            Whether the frame jumps at this sample.
        """
        h = sample_time
        ready = reading.valid & (reading.theta_e_std < self.ready)
        ready_time = jnp.where(ready, state.ready_time + h, 0.0)
        invalid_time = jnp.where(reading.valid, 0.0, state.invalid_time + h)
        was_running = state.mode == RUNNING
        # With zero reference, the position would soon be lost again.
        moves = jnp.abs(reference_e) > 1e-3 * self.speed
        aligned = state.run_time >= self.align
        takes_over = ~was_running & moves & (ready_time >= self.hold) & aligned
        loses = was_running & (~(reading.theta_e_std < self.lost) | (invalid_time > self.ride))
        running = (was_running | takes_over) & ~loses
        # In open loop, the speed of the frame ramps to the reference.
        target = jnp.where(aligned, reference_e, 0.0)
        target = jnp.clip(target, -self.speed, self.speed)
        ramp = self.acceleration * h
        open_speed = state.speed_e + jnp.clip(target - state.speed_e, -ramp, ramp)
        open_direction = state.direction * turn(h * state.speed_e)
        # After a loss, the frame starts at the current vector, so that the torque is continuous.
        follows = loses & (length(current) > 0.05 * self.current)
        open_direction = jnp.where(follows, unit(current), open_direction)
        direction = jnp.where(running, turn(reading.theta_e), open_direction)
        speed_e = jnp.where(running, reading.speed_e, open_speed)
        state = SensorlessState(
            jnp.where(running, RUNNING, STARTING),
            direction,
            speed_e,
            ready_time,
            invalid_time,
            state.run_time + h,
            state.transient * jnp.exp(-h / self.blend),
        )
        return state, direction, speed_e, takes_over | loses
