"""Closed-loop drives with motor, inverter, sensors, control, and an observer in the loop."""

from .. import precision  # noqa: F401  # first, because it enables float64
from .block import BlockRun, simulate_block
from .control import Control
from .examples import RATINGS, Rating, encoder_drive, rating, sensorless_drive
from .inverter import Inverter
from .motor import Mechanics, Motor, Plant
from .profile import Profile
from .sensorless import Sensorless
from .sensors import Sensors
from .simulate import Course, Drive, Event, Run, Trace, simulate, simulate_batch
from .vectors import rms, rpm, to_rms, to_rpm

__all__ = [
    "RATINGS",
    "BlockRun",
    "Control",
    "Course",
    "Drive",
    "Event",
    "Inverter",
    "Mechanics",
    "Motor",
    "Plant",
    "Profile",
    "Rating",
    "Run",
    "Sensorless",
    "Sensors",
    "Trace",
    "encoder_drive",
    "rating",
    "rms",
    "rpm",
    "sensorless_drive",
    "simulate",
    "simulate_batch",
    "simulate_block",
    "to_rms",
    "to_rpm",
]
