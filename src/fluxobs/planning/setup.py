"""The planned drive: machine, ratings, sensors, inverter."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ..campaigns.drives import Cell
from ..errors import UsageError
from ..machines import RotatingMachine
from ..observers import AdaptiveObserver, Priors
from ..simulation.drive import RATINGS, Rating, encoder_drive

#: Component of the gain g in i' = i + g conj(i) over the gain of a phase, both as standard
#: deviations: independent phases give 1/√6.
GAIN_SHARE = 6**-0.5
#: Time in which the rated torque accelerates the rotor to rated speed, unless J is given [s].
RUN_UP = 0.15
#: Usual dead time as a share of the sample time (1.25 µs at 8 kHz), and drop of a switch as a share
#: of the DC link (1.1 V at 540 V, 0.1 V at 48 V).
DEAD_TIME, DROP = 0.01, 0.002
#: Torque as a share of what the rated current gives in the best direction.
TORQUE_SHARE = 0.9


@dataclass(frozen=True)
class Sensors:
    """Accuracy of the current sensors, and loss of the inverter.

    Parameters
    ----------
    noise : float
        Standard deviation of a current component [A].
    offset : float
        Standard deviation of the offset of a component [A].
    gain : float
        Standard deviation of the gain of a phase against the others [1].
    bits : float
        Of the A/D converter.
    range : float
        Largest current that it converts [A].
    dead_time : float
        Uncompensated dead time [s].
    drop : float
        Uncompensated voltage drop of a switch [V].
    """

    noise: float
    offset: float
    gain: float
    bits: float
    range: float
    dead_time: float
    drop: float

    @classmethod
    def usual(cls, current: float, rated: Rating, **given: float | None) -> Sensors:
        """Return given values, and usual ones for a rated current [A] and a drive's ratings."""
        usual = {
            **{"noise": 0.002 * current, "offset": 0.01 * current, "gain": 0.01, "bits": 12.0},
            **{"range": 2.5 * current, "dead_time": DEAD_TIME * rated.sample_time},
            "drop": DROP * rated.dc_link,
        }
        stated = {name: value for name, value in given.items() if value is not None}
        for name in stated:
            if name not in usual:
                raise UsageError(f"unknown value {name}; known are {', '.join(usual)}")
        values = usual | stated
        for name, value in values.items():
            least = {"bits": 1.0, "range": 1e-12}.get(name, 0.0)
            if not least <= value < np.inf:
                raise UsageError(f"--{name.replace('_', '-')}: {value:g} is impossible")
        return cls(**values)

    @property
    def step(self) -> float:
        """Step of the A/D converter [A]."""
        return float(2 * self.range / 2**self.bits)

    @property
    def total_noise(self) -> float:
        """Noise of a sample of a component, with that of the converter's step [A]."""
        return float(np.hypot(self.noise, self.step / 12**0.5))


def rating_of(machine: RotatingMachine, name: str, **given: float | None) -> Rating:
    """Return the ratings of a drive: given ones, those of a shipped machine, or usual ones.

    Parameters
    ----------
    machine : RotatingMachine
        With rated_current.
    name : str
        As the user gave the machine.
    given
        speed_e [rad/s], torque [N m], J [kg m²], dc_link [V], sample_time [s].

    Raises
    ------
    UsageError
        Speed, DC link or sample time is missing.
    """
    if machine.rated_current is None:
        raise UsageError(f"{name}: rated_current is missing in the machine file")
    values: dict[str, float] = dict(vars(RATINGS[name])) if name in RATINGS else {}
    values |= {key: value for key, value in given.items() if value is not None}
    options = {"speed_e": "--speed", "dc_link": "--dc-link", "sample_time": "--sample-time"}
    names = options | {"torque": "--torque", "J": "--inertia"}
    for key, value in values.items():
        if not 0 < value < np.inf:
            raise UsageError(f"{names[key]} must be positive")
    missing = [option for key, option in options.items() if key not in values]
    if missing:
        raise UsageError(f"{name} is not a shipped machine: give its {', '.join(missing)}")
    if "torque" not in values:
        trial = Rating(**{"torque": 1.0, "J": 1e-3, **values})
        control = encoder_drive(machine, trial).control
        # The controller's largest current is 1.5 times the rated one.
        values["torque"] = TORQUE_SHARE * float(control.most_torque()) / 1.5
    speed = values["speed_e"] / machine.n_p
    values.setdefault("J", RUN_UP * values["torque"] / speed)
    return Rating(**{field.name: values[field.name] for field in fields(Rating)})


def quantities(sensors: Sensors, cell: Cell, sign: tuple[float, ...]) -> dict[str, float]:
    """Return the sensors and the inverter as quantities of a campaign.

    Parameters
    ----------
    sign : tuple of float
        Offset along α and β, and gains of the phases a and b, in standard deviations.
    """
    I_n, h = cell.current, cell.rated.sample_time
    along, across, a, b = sign
    return {
        "noise": sensors.noise / I_n,
        "quantum": sensors.step / I_n,
        "range": sensors.range / I_n,
        "offset_alpha": along * sensors.offset / I_n,
        "offset_beta": across * sensors.offset / I_n,
        "gain_a": 1 + a * sensors.gain,
        "gain_b": 1 + b * sensors.gain,
        "dead_time": sensors.dead_time / h,
        "drop": sensors.drop / cell.rated.dc_link,
    }


def observer_of(sensors: Sensors, cell: Cell) -> AdaptiveObserver:
    """Return the adaptive observer of a drive, which knows the accuracy of the sensors."""
    return AdaptiveObserver.for_machine(
        cell.machine,
        sample_time=cell.rated.sample_time,
        dc_link=cell.rated.dc_link,
        rated_current=cell.current,
        current_noise=sensors.total_noise,
        priors=Priors(offset=sensors.offset, current_gain=GAIN_SHARE * sensors.gain),
    )


__all__ = ["Rating", "Sensors", "observer_of", "quantities", "rating_of"]
