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
UNKNOWNS = N + 2 * len(ORDERS)
#: States of the filter; of them flux, angle, speed and ψ are kept.
STATES, OWN = 10, 5
ELEMENTS = 43
FIRMWARE = ENGINE.parent / "firmware"
NUMBERS = ctypes.POINTER(ctypes.c_double)


class Log(ctypes.Structure):
    """A log; see engine/innovations.h."""

    _fields_ = (
        ("rows", ctypes.c_size_t),
        ("sample_time", ctypes.c_double),
        ("voltage", NUMBERS),
        ("current", NUMBERS),
    )


#: Where the model is linearised at a row; see engine/innovations.h.
COURSE = np.dtype(
    [("flux", float, 2), *((name, float) for name in ("angle", "psi", "unrest", "doubt"))]
)


class Machine(ctypes.Structure):
    """Kind of a machine, and its constants that are not estimated; see engine/relation.h."""

    _fields_ = (
        ("map", ctypes.c_void_p),
        ("cage", ctypes.c_bool),
        ("current", ctypes.c_double),
        ("psi_rate", ctypes.c_double),
    )


#: A machine with magnets and constant inductances; its rated current scales the saturation.
LINEAR = Machine(None, False, 12.0, 0.0)


class Start(ctypes.Structure):
    """What is known before the first row: standard deviations; see engine/innovations.h."""

    _fields_ = (
        *(
            (f"{name}_std", ctypes.c_double)
            for name in ("flux", "angle", "speed", "psi", "acceleration", "drift")
        ),
        ("skipped", ctypes.c_size_t),
    )


class Row(ctypes.Structure):
    """What the filter knows at a row; see engine/innovations.h."""

    _fields_ = (
        ("own", ctypes.c_double * OWN),
        ("P", ctypes.c_double * (OWN * STATES)),
        ("error", ctypes.c_double * 2),
        ("inverse", ctypes.c_double * 3),
        ("K", ctypes.c_double * (2 * STATES)),
        ("by_flux", ctypes.c_double * 4),
        ("by_angle", ctypes.c_double * 2),
        ("by_psi", ctypes.c_double * 2),
        ("F", ctypes.c_double * ELEMENTS),
        ("error_by", ctypes.c_double * (2 * UNKNOWNS)),
        ("own_by", ctypes.c_double * (2 * UNKNOWNS)),
        ("measured", ctypes.c_bool),
    )


class _Likelihood(ctypes.Structure):
    _fields_ = (
        ("objective", ctypes.c_double),
        ("score", ctypes.c_double * UNKNOWNS),
        ("information", ctypes.c_double * UNKNOWNS**2),
        ("mean_square", ctypes.c_double),
        ("counted", ctypes.c_size_t),
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
    rows: NDArray[np.void]


@cache
def library(innovations: Path = ENGINE / "innovations.c") -> ctypes.CDLL:
    """Compile the engine with this source of the likelihood as a shared library, and load it."""
    options = ["-std=c99", "-O3", "-ffp-contract=off", "-fPIC", "-shared", f"-I{ENGINE}"]
    options.append(f"-I{FIRMWARE}")
    others = [path for path in sorted(ENGINE.glob("*.c")) if path.name != "innovations.c"]
    others.append(FIRMWARE / "fluxobs_map.c")
    with tempfile.TemporaryDirectory() as folder:
        built = build_program(["gcc"], options, [innovations, *others], Path(folder) / "engine.so")
        loaded = ctypes.CDLL(str(built))
    loaded.fo_innovations.restype = ctypes.c_bool
    return loaded


def all_parameters(parameters: Array) -> Array:
    """Return the parameters, and zero harmonics if they are not given."""
    p = np.zeros(UNKNOWNS)
    p[: len(parameters)] = parameters
    return p


def course_of(current: Complex, angle: Array, parameters: Array) -> NDArray[np.void]:
    """Return the course through these angles; its flux is that of the measured current."""
    L_d, L_q, psi = (np.exp(parameters[INDEX[name]]) for name in ("L_d", "L_q", "psi_f"))
    i = np.where(np.isfinite(current), current, 0) * np.exp(-1j * angle)
    flux = (psi + L_d * i.real + 1j * L_q * i.imag) * np.exp(1j * angle)
    course = np.ones(len(angle), COURSE)
    course["flux"] = np.stack([flux.real, flux.imag], axis=1)
    course["angle"], course["psi"] = angle, 0.0
    return course


def likelihood(
    voltage: Complex,
    current: Complex,
    sample_time: float,
    parameters: Array,
    course: NDArray[np.void],
    start: Start,
    own: ctypes.CDLL | None = None,
    machine: Machine = LINEAR,
) -> Likelihood:
    """Evaluate a log at the parameters; AssertionError if a number is not finite."""
    rows, out = (Row * len(current))(), _Likelihood()
    with log_of(voltage, current, sample_time) as log:
        done = (own or library()).fo_innovations(
            ctypes.byref(log),
            ctypes.byref(machine),
            pointer(course),
            pointer(all_parameters(parameters)),
            ctypes.byref(start),
            ctypes.byref(out),
            rows,
        )
    assert done, "the covariance is not positive, or a number is not finite"
    kept = np.frombuffer(rows, dtype=np.dtype(Row))
    n = UNKNOWNS
    information = np.array(out.information).reshape(n, n)
    return Likelihood(out.objective, np.array(out.score), information, out.mean_square, kept)


def smoothed_course(likelihood: Likelihood, course: NDArray[np.void]) -> NDArray[np.void]:
    """Return the course of the smoothed rows, with the unrest of the given course."""
    out, rows = course.copy(), np.ascontiguousarray(likelihood.rows)
    library().fo_smooth_course(
        rows.ctypes.data_as(ctypes.POINTER(Row)), ctypes.c_size_t(len(rows)), pointer(out)
    )
    return out


def settled(
    voltage: Complex,
    current: Complex,
    sample_time: float,
    parameters: Array,
    course: NDArray[np.void],
    start: Start,
    own: ctypes.CDLL | None = None,
    passes: int = 3,
    machine: Machine = LINEAR,
) -> tuple[Likelihood, NDArray[np.void]]:
    """Evaluate a log about the course that its smoothing settles at."""
    got = likelihood(voltage, current, sample_time, parameters, course, start, own, machine)
    for _ in range(passes):
        course = smoothed_course(got, course)
        got = likelihood(voltage, current, sample_time, parameters, course, start, own, machine)
    return got, course
