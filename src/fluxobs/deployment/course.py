"""A short record that takes the observer through everything it can meet, for its tests in C.

Closed form, in steps of converters: a start from rest at an unknown angle, a run-up, a voltage
offset beyond its prior, a step of load, samples that are missing, contradict or are absurd, a stop
through which the flux is carried, and the reverse.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..machines import RotatingMachine, SurfacePMSM
from ..observers import LeastSquaresObserver

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
class Course:
    """Rows as an interrupt sees them: the voltage of the interval that ends at each, the current.

    All values fit single precision.
    """

    voltage: Array  # (rows, 2) [V]
    current: Array  # (rows, 2) [A]
    theta_e: Array  # (rows,) the true angle [rad]


def course(machine: RotatingMachine, observer: LeastSquaresObserver) -> Course:
    """The record for a machine: currents a tenth to the whole of the rated one."""
    sample_time, rated_current = observer.sample_time, machine.rated_current
    assert rated_current is not None
    psi_f: float | None = getattr(machine, "psi_f", None)
    h = sample_time / PARTS
    k = np.arange(ROWS * PARTS + 1) / PARTS
    rows, shares = zip(*SPEED, strict=True)
    speed = 2 * np.pi / (PERIOD * sample_time) * np.interp(k, rows, shares)
    angle = START_ANGLE + np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * h)])
    turn = np.exp(1j * angle)
    load = np.interp(k, (20, 60, LOAD_ROW, LOAD_ROW + 20), (0.0, 0.1, 0.1, 0.8))
    i_dq = rated_current * (1j * load + (0.0 if psi_f else 0.5 * np.minimum(1, k / 40)))
    if isinstance(machine, SurfacePMSM):
        flux_dq = machine.L_s * i_dq + (psi_f or 0.0)
    else:
        L_d, L_q = machine.L_d, machine.L_q  # type: ignore[attr-defined]
        flux_dq = L_d * i_dq.real + 1j * L_q * i_dq.imag + (psi_f or 0.0)
    current = i_dq * turn
    parts = current[:-1].reshape(ROWS, PARTS)
    mean = (parts.sum(axis=1) + (current[PARTS::PARTS] - current[:-1:PARTS]) / 2) / PARTS
    voltage = np.diff((flux_dq * turn)[::PARTS]) / sample_time + machine.R_s * mean

    voltage += 1.5 * observer.drift_prior
    offset = 0.01 * rated_current * (1 - 0.5j)
    step = 2.0 ** np.ceil(np.log2(4 * rated_current / 2**BITS))
    measured = np.round(_pairs(current[PARTS::PARTS] + offset) / step) * step
    measured[ABSURD_ROW] = 1e6 * rated_current
    measured[MISSING_CURRENT_ROW] = np.nan
    # A spike that turns the position vector by a radian and leaves its length.
    L = machine.position_inductance
    x = (flux_dq - L * i_dq)[SPIKE_ROW * PARTS + PARTS] * turn[SPIKE_ROW * PARTS + PARTS]
    measured[SPIKE_ROW] += _pairs(x * (1 - np.exp(1j)) / L)
    applied = _pairs(voltage)
    applied[MISSING_VOLTAGE_ROW : MISSING_VOLTAGE_ROW + 2] = np.nan
    return Course(_single(applied), _single(measured), np.angle(turn[PARTS::PARTS]))


def _pairs(z: NDArray[np.complex128]) -> Array:
    return np.stack([z.real, z.imag], axis=-1)


def _single(x: Array) -> Array:
    return x.astype(np.float32).astype(float)
