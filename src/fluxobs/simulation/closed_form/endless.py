"""A demonstration drive that accelerates, is loaded, stops, reverses and warms up, without end."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count

import numpy as np

from ...machines import example, rotating
from ...machines.model.frames import wrap
from .demo import (
    CURRENT_NOISE,
    CURRENT_OFFSET,
    CURRENT_STEP,
    INVERTER_VOLTAGE,
    KNEE,
    MACHINE,
    SAMPLE_TIME,
    SEED,
    VOLTAGE_OFFSET,
    VOLTAGE_STEP,
    smooth,
)
from .sensors import Sensor, Steps
from .signals import driven, inverter_loss, vectors

COLUMNS = ("t", "u_alpha", "u_beta", "i_alpha", "i_beta", "theta_e")
#: Period of speed and load [s].
CYCLE = 4.0
#: Share by which the winding's resistance grows; time constant of this growth [s].
WARMER, WARMING = 0.25, 40.0
_PARTS = 16


def endless() -> Iterator[list[float]]:
    """Yield rows of `COLUMNS` in SI units without end; theta_e is the truth."""
    machine = rotating(example(MACHINE))
    rows = round(CYCLE / SAMPLE_TIME)
    t = np.arange(rows * _PARTS + 1) * SAMPLE_TIME / _PARTS
    speed = smooth(t, (0.0, 350.0), (0.3, 350.0), (0.6, 900.0), (1.2, 900.0), (1.9, -500.0))
    speed += smooth(t, (2.6, 0.0), (3.2, 500.0), (3.4, 500.0), (3.8, 850.0))
    i_q = smooth(t, (0.1, 1.0), (0.3, 6.0), (0.6, 2.0), (0.8, 2.0), (0.81, 9.0), (1.2, 9.0))
    i_q += smooth(t, (1.2, 0.0), (1.3, -14.0), (1.9, -14.0), (2.0, -11.0), (2.6, -11.0))
    i_q += smooth(t, (2.6, 0.0), (2.7, 9.0), (3.7, 9.0), (4.0, 3.0))
    voltage = Sensor(Steps(np.array([VOLTAGE_OFFSET])), quantum=VOLTAGE_STEP)
    current = Sensor(Steps(np.array([CURRENT_OFFSET])), CURRENT_NOISE, CURRENT_STEP)
    angle = 0.8
    for cycle in count():
        warm = 1 + WARMER * (1 - np.exp(-cycle * CYCLE / WARMING))
        warmed = machine.with_values(R_s=warm * machine.R_s)
        true = driven(warmed, SAMPLE_TIME, speed, 1j * i_q, _PARTS, theta0=angle)
        angle = float(true.theta_e[-1])
        times = (cycle * rows + np.arange(rows)) * SAMPLE_TIME
        lost = inverter_loss(true.mean_current, INVERTER_VOLTAGE, KNEE)
        u = voltage.measure(times, vectors(true.voltage + lost), SEED + cycle)
        i = current.measure(times, vectors(true.current[:-1]), SEED + cycle)
        yield from np.column_stack([times, u, i, wrap(true.theta_e[:-1])]).tolist()
