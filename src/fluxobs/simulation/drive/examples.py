"""Drives of the shipped machines, with or without an encoder."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...errors import ModelError
from ...machines import RotatingMachine
from ...observers import LeastSquaresObserver
from ...observers.plain import MEMORY, TRACKER
from .control import CageControl, Control
from .inverter import Inverter
from .loop_observer import LoopObserver
from .motor import CageMotor, Mechanics, Motor, Plant
from .sensorless import Sensorless
from .sensors import Sensors
from .simulate import Drive


@dataclass(frozen=True)
class Rating:
    """Data of a drive that are not in its machine file.

    Attributes
    ----------
    speed_e : float
        Rated electrical speed [rad/s].
    torque : float
        Rated torque [N m].
    J : float
        Inertia [kg m²].
    dc_link : float
        DC-link voltage [V].
    sample_time : float
        Sample time [s].
    """

    speed_e: float
    torque: float
    J: float
    dc_link: float
    sample_time: float


#: Ratings of the shipped machines.
RATINGS = {
    "pmsm-2kw2": Rating(2 * np.pi * 75, 14.0, 0.015, 540.0, 1.25e-4),
    "ipm-2kw2": Rating(2 * np.pi * 75, 14.0, 0.015, 540.0, 1.25e-4),
    "synrm-6kw7": Rating(2 * np.pi * 106, 20.0, 0.015, 540.0, 1.25e-4),
    "servo-400w": Rating(2 * np.pi * 200, 0.8, 6e-5, 48.0, 1e-4),
    "induction-2kw2": Rating(2 * np.pi * 50, 14.0, 0.015, 540.0, 1.25e-4),
    "ipm-5kw6": Rating(2 * np.pi * 60, 29.7, 0.05, 540.0, 1.25e-4),
    "synrm-6kw7-saturated": Rating(2 * np.pi * 106, 20.0, 0.015, 540.0, 1.25e-4),
    "drone-900kv": Rating(2 * np.pi * 350, 0.25, 4e-5, 24.0, 5e-5),
}


def rating(name: str) -> Rating:
    """Return the rating of a shipped machine.

    Raises
    ------
    ModelError
        If the machine has no rating. The message lists the machines with a rating.
    """
    if name not in RATINGS:
        raise ModelError(f"no drive is defined for {name!r}; choose one of {', '.join(RATINGS)}")
    return RATINGS[name]


def _rated_current(machine: RotatingMachine) -> float:
    """Return the rated current [A]; raise ModelError if it is missing."""
    if machine.rated_current is None:
        raise ModelError(f"rated_current is missing in the {machine.kind}: simulation needs it")
    return machine.rated_current


def _start_current(machine: RotatingMachine) -> float:
    """Return the length of the current vector that turns the rotor in open loop [A].

    For a cage, this current gives rated flux at the slip of largest torque.
    """
    if machine.flux_moves:
        return float(np.sqrt(2) * machine.magnetizing_current)
    return _rated_current(machine)


def _control(motor: Motor, machine: RotatingMachine, rated: Rating, **options: Any) -> Control:
    """Create a controller for 1.5 times the rated current.

    If the voltage exceeds its limit by udc, field weakening reaches this current within 20 ms.
    """
    limit = 1.5 * _rated_current(machine)
    weakening = limit / (0.02 * rated.dc_link)
    kind = CageControl if isinstance(motor, CageMotor) else Control
    return kind.of(motor, rated.J, rated.sample_time, limit, weakening=weakening, **options)


def encoder_drive(machine: RotatingMachine, rated: Rating, **sensors: Any) -> Drive:
    """Create a drive with an encoder, an ideal inverter and 1.5 times the rated current.

    `sensors` go to :class:`Sensors`.
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
    """Create a drive like :func:`encoder_drive`, with the least squares instead of the encoder.

    Parameters
    ----------
    memory : float
        Memory of the observer [s]; choose about the time of half a turn at the slowest speed.
    believed : RotatingMachine, optional
        Machine that the observer and the controller assume.
    current_noise, drift_prior : float, optional
        Passed to :meth:`LeastSquaresObserver.for_machine`.
    speed_bandwidth : float, optional
        Bandwidth of the speed controller [rad/s]; default 0.75 over the memory, at most 2π 8. With
        a wrong R, the angle is wrong for one memory after each torque change, and a speed
        controller that responds within this time can oscillate. With the right R, it can be faster.
    """
    drive = encoder_drive(machine, rated, **sensors)
    assumed = machine if believed is None else believed
    compiled = LeastSquaresObserver.for_machine(
        assumed,
        sample_time=rated.sample_time,
        memory=memory,
        current_noise=current_noise,
        drift_prior=drift_prior,
    )
    # The speed controller needs a speed estimate that is as fast as with the default memory.
    bandwidth = min(TRACKER / MEMORY, 0.5 / rated.sample_time)
    compiled = replace(compiled, tracker_bandwidth=bandwidth)
    # During `ride`, a voltage error equal to the drift prior S turns the flux by half a radian.
    # With this error, a position is valid only above S/(0.14 ψ) (docs/theory.md, section 6).
    radian = compiled.flux_base / compiled.drift_prior
    ride, start_speed = 0.5 * radian, max(0.1 * rated.speed_e, 1.5 / (0.14 * radian))
    if speed_bandwidth is None:
        speed_bandwidth = min(2 * np.pi * 8, 0.75 / memory)
    return replace(
        drive,
        control=_control(Motor.of(assumed), machine, rated, speed_bandwidth=speed_bandwidth),
        observer=LoopObserver.of(compiled),
        sensorless=Sensorless.for_drive(
            _start_current(assumed), rated.speed_e, ride=ride, speed=start_speed
        ),
    )
