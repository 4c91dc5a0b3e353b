"""A short record for the C tests of the observer; it uses every branch of the code.

The record is in closed form and quantised by converters. It contains a start from rest at an
unknown angle, a run-up, a voltage offset larger than its prior, a load step, missing, contradictory
and implausible samples, a stop during which the flux is integrated, and a reversal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.arrays import Array
from ...machines import RotatingMachine
from ...machines.model.frames import wrap
from ...observers import LeastSquaresObserver
from .signals import driven, vectors

#: Samples per electrical period at full speed: PERIOD. More if a sample is shorter than USUAL [s],
#: fewer (at least FASTEST) if the EMF must be larger.
PERIOD, FASTEST, USUAL = 36, 12, 1e-4
#: EMF over the voltage error of resistance and inverter. A position is valid above half this ratio.
CLEAR = 4.0
#: (row, share of full speed), linear between the rows. The stop is so long that an observer with a
#: memory of 50 samples integrates the flux during the stop.
SPEED = ((0, 0.0), (40, 0.0), (140, 1.0), (660, 1.0), (740, 0.0), (1280, 0.0), (1380, -0.8))
#: A memory of more than MEMORY samples prolongs the run without load after CRUISE_ROW, because a
#: valid position needs three memories and all later events need a valid position.
CRUISE_ROW, MEMORY, MEMORIES = 140, 300, 3.5
LOAD_ROW, ABSURD_ROW = 220, 380
MISSING_CURRENT_ROW, MISSING_VOLTAGE_ROW, SPIKE_ROW = 280, 300, 320
ROWS = 1540
#: Bits of the current converter, whose range is ± two rated currents.
BITS = 12
START_ANGLE = 2.0
#: Number of parts per interval when the current is integrated.
PARTS = 16


@dataclass(frozen=True)
class FirmwareRecord:
    """Rows as an interrupt gets them: a current and the voltage of the previous interval.

    Single precision represents all values exactly.
    """

    voltage: Array  # Shape (rows, 2) [V].
    current: Array  # Shape (rows, 2) [A].
    theta_e: Array  # True angle (rows,) [rad].


def firmware_record(
    machine: RotatingMachine, observer: LeastSquaresObserver, unsure: float = 0.0
) -> FirmwareRecord:
    """Return the record for a machine, with currents from 0.1 to 1 times the rated current.

    Parameters
    ----------
    machine : RotatingMachine
    observer : LeastSquaresObserver
        The record suits this observer's sample time, memory and drift prior.
    unsure : float
        Voltage error of resistance and inverter [V].
    """
    h, rated = observer.sample_time, machine.rated_current
    assert rated is not None
    longer = max(0, round(MEMORIES * (observer.memory / h - MEMORY)))
    rows = np.arange((ROWS + longer) * PARTS + 1) / PARTS
    k = rows - np.clip(rows - CRUISE_ROW, 0, longer)  # Row of the record without prolongation.
    emf = CLEAR * unsure / observer.flux_base  # Expressed as a speed [rad/s].
    longest = PERIOD * max(1.0, USUAL / h)
    period = float(np.clip(2 * np.pi / max(emf * h, 1e-9), FASTEST, longest))
    knots, shares = zip(*SPEED, strict=True)
    speed = 2 * np.pi / (period * h) * np.interp(k, knots, shares)
    load = np.interp(k, (20, 60, LOAD_ROW, LOAD_ROW + 20), (0.0, 0.1, 0.1, 0.8))
    i_d: Array | float = machine.magnetizing_current / rated
    if not machine.magnets:
        i_d = 0.5 * np.minimum(1, k / 40)
    i_dq = rated * (i_d + 1j * load)
    true = driven(machine, h, speed, np.asarray(i_dq, complex), PARTS, START_ANGLE)

    bias = 0.01 * rated * (1 - 0.5j)
    step = 2.0 ** np.ceil(np.log2(4 * rated / 2**BITS))
    measured = np.round(vectors(true.current[1:] + bias) / step) * step
    measured[ABSURD_ROW + longer] = 1e6 * rated
    measured[MISSING_CURRENT_ROW + longer] = np.nan
    # This spike turns the position vector by one radian without changing its length.
    L = machine.position_inductance
    x = (true.flux - L * true.current)[SPIKE_ROW + longer + 1]
    measured[SPIKE_ROW + longer] += vectors(x * (1 - np.exp(1j)) / L)
    applied = vectors(true.voltage + 1.5 * observer.drift_prior)
    missing = MISSING_VOLTAGE_ROW + longer
    applied[missing : missing + 2] = np.nan
    return FirmwareRecord(
        _round_to_single(applied), _round_to_single(measured), wrap(true.theta_e[1:])
    )


def _round_to_single(x: Array) -> Array:
    """Round to single precision."""
    return x.astype(np.float32).astype(float)
