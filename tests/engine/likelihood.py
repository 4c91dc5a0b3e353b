"""The likelihood of engine/innovations.c from Python."""

from __future__ import annotations

import ctypes
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from support.compiling import build_program

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
ENGINE = Path(__file__).parents[2] / "engine"
HEADER = (ENGINE / "parameters.h").read_text("utf-8")
#: Names of the parameters, in the order of the C source.
NAMES = tuple(re.findall(r"NAME\((\w+)\)", HEADER))
N = len(NAMES)
INDEX = {name: k for k, name in enumerate(NAMES)}
#: Orders of the harmonics of the flux; each has two coefficients after the parameters.
ORDERS = tuple(map(int, re.findall(r"ORDER\((-?\d+)\)", HEADER)))
#: The last unknown is the first angle.
UNKNOWNS = N + 2 * len(ORDERS) + 1
STATES = 10
NUMBERS = ctypes.POINTER(ctypes.c_double)


class Log(ctypes.Structure):
    """A log; see engine/innovations.h."""

    _fields_ = (
        ("rows", ctypes.c_size_t),
        ("sample_time", ctypes.c_double),
        ("voltage", NUMBERS),
        ("current", NUMBERS),
    )


class Start(ctypes.Structure):
    """The state at the first row, with standard deviations; see engine/innovations.h."""

    _fields_ = (
        *((name, ctypes.c_double) for name in ("angle", "angle_std", "speed", "speed_std")),
        *((f"{name}_std", ctypes.c_double) for name in ("acceleration", "flux", "drift", "gain")),
        ("skipped", ctypes.c_size_t),
        ("price", ctypes.c_double),
    )


class Row(ctypes.Structure):
    """What the filter knows at a row; see engine/innovations.h."""

    _fields_ = (
        ("angle", ctypes.c_double),
        ("speed", ctypes.c_double),
        ("P", ctypes.c_double * STATES**2),
        ("error", ctypes.c_double * 2),
        ("inverse", ctypes.c_double * 4),
        ("K", ctypes.c_double * (2 * STATES)),
        ("H", ctypes.c_double * (2 * STATES)),
        ("F", ctypes.c_double * STATES**2),
        ("error_by", ctypes.c_double * (2 * UNKNOWNS)),
        ("state_by", ctypes.c_double * (2 * UNKNOWNS)),
        ("measured", ctypes.c_bool),
    )


class _Likelihood(ctypes.Structure):
    _fields_ = (
        ("objective", ctypes.c_double),
        ("score", ctypes.c_double * UNKNOWNS),
        ("information", ctypes.c_double * UNKNOWNS**2),
        ("mean_square", ctypes.c_double),
        ("counted", ctypes.c_size_t),
        ("losses", ctypes.c_size_t),
    )


def pointer(values: NDArray[Any]) -> ctypes._Pointer[ctypes.c_double]:
    """Return the address of the numbers."""
    return values.ctypes.data_as(NUMBERS)


@contextmanager
def log_of(voltage: Complex, current: Complex, sample_time: float) -> Iterator[Log]:
    """Give the log as C reads it, while its arrays exist."""
    u, i = (np.ascontiguousarray(np.stack([x.real, x.imag], axis=1)) for x in (voltage, current))
    yield Log(len(i), sample_time, pointer(u), pointer(i))


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Objective, its derivative, and the expected second derivative."""

    objective: float
    score: Array
    information: Array
    mean_square: float
    losses: int
    rows: NDArray[np.void]


@cache
def library(innovations: Path = ENGINE / "innovations.c") -> ctypes.CDLL:
    """Compile the engine with this source of the likelihood as a shared library, and load it."""
    options = ["-std=c99", "-O3", "-ffp-contract=off", "-fPIC", "-shared", f"-I{ENGINE}"]
    others = [path for path in sorted(ENGINE.glob("*.c")) if path.name != "innovations.c"]
    with tempfile.TemporaryDirectory() as folder:
        built = build_program(["gcc"], options, [innovations, *others], Path(folder) / "engine.so")
        loaded = ctypes.CDLL(str(built))
    loaded.fo_innovations.restype = ctypes.c_bool
    return loaded


def likelihood(
    voltage: Complex,
    current: Complex,
    sample_time: float,
    parameters: Array,
    start: Start,
    own: ctypes.CDLL | None = None,
) -> Likelihood:
    """Evaluate a log at the parameters; AssertionError if a number is not finite."""
    p = np.zeros(UNKNOWNS)
    p[: len(parameters)] = parameters
    rows, out = (Row * len(current))(), _Likelihood()
    with log_of(voltage, current, sample_time) as log:
        done = (own or library()).fo_innovations(
            ctypes.byref(log), pointer(p), ctypes.byref(start), ctypes.byref(out), rows
        )
    assert done, "the covariance is not positive, or a number is not finite"
    kept = np.frombuffer(rows, dtype=np.dtype(Row))
    n = UNKNOWNS
    information = np.array(out.information).reshape(n, n)
    return Likelihood(
        out.objective, np.array(out.score), information, out.mean_square, out.losses, kept
    )
