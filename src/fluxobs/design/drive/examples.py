"""Drives around the shipped machines, with an encoder or without."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...errors import ModelError
from ...machines import RotatingMachine
from ...observers import LeastSquaresObserver
from ...observers.plain import MEMORY, TRACKER
from .control import Control
from .inverter import Inverter
from .motor import Mechanics, Motor, Plant
from .sensorless import Sensorless
from .sensors import Sensors
from .simulate import Drive
from .twin import SquareRootLeastSquares


@dataclass(frozen=True)
class Rating:
    """What a machine file does not say of a drive.

    Attributes
    ----------
    speed_e : float
        Rated, electrical [rad/s].
    torque : float
        Rated [N m].
    J : float
        Inertia [kg m²].
    dc_link : float
        [V].
    sample_time : float
        [s].
    """

    speed_e: float
    torque: float
    J: float
    dc_link: float
    sample_time: float


#: Of the shipped machines.
RATINGS = {
    "pmsm-2kw2": Rating(2 * np.pi * 75, 14.0, 0.015, 540.0, 1.25e-4),
    "ipm-2kw2": Rating(2 * np.pi * 75, 14.0, 0.015, 540.0, 1.25e-4),
    "synrm-6kw7": Rating(2 * np.pi * 106, 20.0, 0.015, 540.0, 1.25e-4),
    "servo-400w": Rating(2 * np.pi * 200, 0.8, 6e-5, 48.0, 1e-4),
    "drone-900kv": Rating(2 * np.pi * 350, 0.25, 4e-5, 24.0, 5e-5),
}


def rating(name: str) -> Rating:
    """Of a shipped machine.

    Raises
    ------
    ModelError
        A machine without one: names those with.
    """
    if name not in RATINGS:
        raise ModelError(f"no drive is defined for {name!r}; there is one for {', '.join(RATINGS)}")
    return RATINGS[name]


def _rated_current(machine: RotatingMachine) -> float:
    if machine.rated_current is None:
        raise ModelError(f"rated_current is missing in the {machine.kind}: simulation needs it")
    return machine.rated_current


def _control(motor: Motor, machine: RotatingMachine, rated: Rating, **given: Any) -> Control:
    """For half again the rated current; field weakening brings the whole of it within 20 ms at a
    voltage that is the DC link too high."""
    most = 1.5 * _rated_current(machine)
    weakening = most / (0.02 * rated.dc_link)
    return Control.of(motor, rated.J, rated.sample_time, most, weakening=weakening, **given)


def encoder_drive(machine: RotatingMachine, rated: Rating, **sensors: Any) -> Drive:
    """Drive with an encoder, an ideal inverter and half again the rated current.

    `sensors` are arguments of :class:`Sensors`.
    """
    motor = Motor.of(machine)
    plant = Plant(motor, Mechanics(rated.J))
    return Drive(plant, Inverter(), Sensors(**sensors), _control(motor, machine, rated))


def sensorless_drive(
    machine: RotatingMachine,
    rated: Rating,
    memory: float = MEMORY,
    believed: RotatingMachine | None = None,
    current_noise: float | None = None,
    drift_prior: float | None = None,
    speed_bandwidth: float | None = None,
    **sensors: Any,
) -> Drive:
    """The same with the least squares in the loop instead of the encoder.

    Parameters
    ----------
    memory : float
        [s]; about the time of half a turn at the slowest speed to be held.
    believed : RotatingMachine, optional
        What observer and controller take the machine for.
    current_noise, drift_prior : float, optional
        Of the observer, see :meth:`LeastSquaresObserver.for_machine`.
    speed_bandwidth : float, optional
        Of the speed controller [rad/s]; default three quarters over the memory, 2π 8 at most. A
        wrong R turns the angle for a memory after each change of the torque, and a speed
        controller that answers within that time can oscillate with it. With the right R a faster
        one does no harm.
    """
    drive = encoder_drive(machine, rated, **sensors)
    taken = machine if believed is None else believed
    compiled = LeastSquaresObserver.for_machine(
        taken,
        sample_time=rated.sample_time,
        memory=memory,
        current_noise=current_noise,
        drift_prior=drift_prior,
    )
    # The speed controller needs a speed that is no slower than with the usual memory.
    bandwidth = min(TRACKER / MEMORY, 0.5 / rated.sample_time)
    compiled = replace(compiled, tracker_bandwidth=bandwidth)
    # A voltage error as large as the drift's prior S turns the flux by half a radian meanwhile. It
    # leaves a position valid only above S/(0.14 ψ) (docs/theory.md, section 6).
    radian = compiled.flux_base / compiled.drift_prior
    ride, start_speed = 0.5 * radian, max(0.1 * rated.speed_e, 1.5 / (0.14 * radian))
    if speed_bandwidth is None:
        speed_bandwidth = min(2 * np.pi * 8, 0.75 / memory)
    return replace(
        drive,
        control=_control(Motor.of(taken), machine, rated, speed_bandwidth=speed_bandwidth),
        observer=SquareRootLeastSquares.of(compiled),
        sensorless=Sensorless.for_drive(
            _rated_current(machine), rated.speed_e, ride=ride, speed=start_speed
        ),
    )
