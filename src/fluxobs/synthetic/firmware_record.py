"""A short record that takes the observer through everything it can meet, for its tests in C.

Closed form, in steps of converters: a start from rest at an unknown angle, a run-up, a voltage
offset beyond its prior, a step of load, samples that are missing, contradict or are absurd, a stop
through which the flux is carried, and the reverse.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..machines import RotatingMachine
from ..model.frames import wrap
from ..observers import LeastSquaresObserver
from .signals import driven, vectors

Array = NDArray[np.float64]

#: Samples an electrical period at full speed.
PERIOD = 36
#: (row, share of full speed), straight between. The stop is long enough to be carried through where
#: the memory is 50 samples.
SPEED = ((0, 0.0), (40, 0.0), (140, 1.0), (660, 1.0), (740, 0.0), (1280, 0.0), (1380, -0.8))
LOAD_ROW, ABSURD_ROW = 220, 380
MISSING_CURRENT_ROW, MISSING_VOLTAGE_ROW, SPIKE_ROW = 280, 300, 320
ROWS = 1540
#: Bits of the current converter over its range, of two rated currents either way.
BITS = 12
START_ANGLE = 2.0
#: Parts of an interval for its integral of the current.
PARTS = 16


@dataclass(frozen=True)
class FirmwareRecord:
    """Rows as an interrupt sees them: the voltage of the interval that ends at each, the current.

    All values fit single precision.
    """

    voltage: Array  # (rows, 2) [V]
    current: Array  # (rows, 2) [A]
    theta_e: Array  # (rows,) the true angle [rad]


def firmware_record(machine: RotatingMachine, observer: LeastSquaresObserver) -> FirmwareRecord:
    """The record for a machine: currents a tenth to the whole of the rated one."""
    h, rated = observer.sample_time, machine.rated_current
    assert rated is not None
    k = np.arange(ROWS * PARTS + 1) / PARTS
    rows, shares = zip(*SPEED, strict=True)
    speed = 2 * np.pi / (PERIOD * h) * np.interp(k, rows, shares)
    load = np.interp(k, (20, 60, LOAD_ROW, LOAD_ROW + 20), (0.0, 0.1, 0.1, 0.8))
    along = 0.0 if machine.magnets else 0.5 * np.minimum(1, k / 40)
    i_dq = rated * (along + 1j * load)
    true = driven(machine, h, speed, np.asarray(i_dq, complex), PARTS, START_ANGLE)

    bias = 0.01 * rated * (1 - 0.5j)
    step = 2.0 ** np.ceil(np.log2(4 * rated / 2**BITS))
    measured = np.round(vectors(true.current[1:] + bias) / step) * step
    measured[ABSURD_ROW] = 1e6 * rated
    measured[MISSING_CURRENT_ROW] = np.nan
    # A spike that turns the position vector by a radian and leaves its length.
    L = machine.position_inductance
    x = (true.flux - L * true.current)[SPIKE_ROW + 1]
    measured[SPIKE_ROW] += vectors(x * (1 - np.exp(1j)) / L)
    applied = vectors(true.voltage + 1.5 * observer.drift_prior)
    applied[MISSING_VOLTAGE_ROW : MISSING_VOLTAGE_ROW + 2] = np.nan
    return FirmwareRecord(_single(applied), _single(measured), wrap(true.theta_e[1:]))


def _single(x: Array) -> Array:
    return x.astype(np.float32).astype(float)
