"""The estimate of engine/estimate.c from Python."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.likelihood import (
    INDEX,
    SENSITIVE,
    SMOOTHED,
    UNKNOWNS,
    Array,
    Complex,
    address,
    library,
    log_of,
    pointer,
)
from fluxobs.machines.model.frames import wrap

NO_ESTIMATE = 1
#: Relative standard deviations of a machine file: resistance, inductances, magnet flux.
TOLERANCES = (0.3, 0.15, 0.15)


class NoEstimate(Exception):
    """The likelihood cannot be evaluated: the log contradicts the start."""


class File(ctypes.Structure):
    """A machine file; see engine/estimate.h."""

    _fields_ = tuple(
        (name, ctypes.c_void_p if name == "map" else ctypes.c_double)
        for name in (
            *("R", "L_d", "L_q", "psi_f", "rated_current", "R_std", "L_std", "psi_std"),
            *("map", "flux", "R_R", "L_M", "cage_std", "lag", "lag_std"),
            *("delay_std", "iron_std", "heat_std", "offset_std", "gain_std", "saturation_std"),
        )
    )


class _Posterior(ctypes.Structure):
    _fields_ = (
        ("parameters", ctypes.c_double * UNKNOWNS),
        ("covariance", ctypes.c_double * UNKNOWNS**2),
        *(
            (name, ctypes.c_double)
            for name in ("harmonics", "objective", "mean_square", "conflict")
        ),
        ("evaluations", ctypes.c_size_t),
        ("converged", ctypes.c_bool),
    )


class _Estimates(ctypes.Structure):
    _fields_ = (
        ("rows", ctypes.c_void_p),
        ("shares", ctypes.c_void_p),
        ("stride", ctypes.c_size_t),
    )


#: Rows of which one has shares of its variances; quantities and shares; see engine/backward.h.
STRIDE, SHARES = 7, (4, SENSITIVE + 1)


@dataclass(frozen=True, eq=False)
class Estimate:
    """Rows and parameters of a log."""

    rows: NDArray[np.void]
    #: Of every STRIDE-th row: quantities, and their shares.
    shares: Array
    parameters: Array
    covariance: Array
    harmonics: float
    objective: float
    mean_square: float
    conflict: float
    evaluations: int
    converged: bool

    def value(self, name: str) -> float:
        return float(self.parameters[INDEX[name]])

    def std(self, name: str) -> float:
        return float(np.sqrt(self.covariance[INDEX[name], INDEX[name]]))


def file_of(
    R: float,
    L_d: float,
    L_q: float,
    psi_f: float,
    rated_current: float,
    tolerances: tuple[float, float, float] = TOLERANCES,
    lag: tuple[float, float] = (0.0, 0.3),
    voltage: float | None = None,
) -> File:
    """Return a machine file with ordinary tolerances; `lag` is a prior: mean and std [samples].

    `voltage`: rms value of a drive with errors of its sensors, iron loss and heat; None: without.
    """
    file = File(R, L_d, L_q, psi_f, rated_current, *tolerances, flux=psi_f)
    file.lag, file.lag_std = lag
    return with_errors(file, voltage)


def with_errors(file: File, voltage: float | None) -> File:
    """Let the drive of this rms voltage [V] have errors of its sensors, iron loss and heat."""
    if voltage is not None:
        current = file.rated_current
        file.delay_std, file.heat_std, file.gain_std = 0.2, 0.05, 0.01
        file.iron_std, file.offset_std = 0.02 * current / voltage, 0.02 * current
    return file


def estimate(
    voltage: Complex,
    current: Complex,
    sample_time: float,
    file: File,
    angle: Array,
    parameters: dict[str, float] | None = None,
    sure: bool = True,
) -> Estimate:
    """Estimate a log from angles, NaN where they are not known; `sure`: those of valid rows.

    NoEstimate if the log contradicts them. `parameters`: where learning starts, instead of the
    machine file.
    """
    rows, out = np.zeros(len(current), SMOOTHED), _Posterior()
    shares = np.zeros((-(-len(rows) // STRIDE), *SHARES))
    begin = np.full(UNKNOWNS, np.nan)
    for name, value in (parameters or {}).items():
        begin[INDEX[name]] = value
    course = np.ascontiguousarray(angle, float)
    with log_of(voltage, current, sample_time) as log:
        outcome = library().fo_estimate_log(
            ctypes.byref(log),
            ctypes.byref(file),
            pointer(course),
            ctypes.c_bool(sure),
            pointer(begin),
            ctypes.byref(out),
            ctypes.byref(_Estimates(address(rows), address(shares), STRIDE)),
        )
    if outcome == NO_ESTIMATE:
        raise NoEstimate
    assert outcome == 0, "no memory"
    return Estimate(
        rows,
        shares,
        np.array(out.parameters),
        np.array(out.covariance).reshape(UNKNOWNS, UNKNOWNS),
        out.harmonics,
        out.objective,
        out.mean_square,
        out.conflict,
        out.evaluations,
        out.converged,
    )


def degrees(angle: Array, true: Array) -> Array:
    """Return the error of an angle [°]."""
    return np.degrees(wrap(angle - true))
