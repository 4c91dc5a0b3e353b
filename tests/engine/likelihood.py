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

from fluxobs.inference.posterior import ROW_NUMBERS
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
#: Parameters that change covariances only, and those of the linearised model.
LEVELS = NAMES[: NAMES.index("colour_pole")]
MODEL = NAMES[NAMES.index("resistance") : NAMES.index("loss")]
#: States of the filter, the first of the noise; the current depends on BY of them.
STATES, NOISE, BY = 10, 8, 4
ELEMENTS, BENT = 43, 26
SENSITIVE = UNKNOWNS - len(LEVELS)
CHUNK = 64
#: Detail of the likelihood: information of all; what is kept of rows: derivatives of the states.
ALL, KEEP_SENSITIVE = 1, 2
FIRMWARE = ENGINE.parent / "firmware"
NUMBERS = ctypes.POINTER(ctypes.c_double)


class Log(ctypes.Structure):
    """A log; see engine/innovations.h."""

    _fields_ = (
        ("rows", ctypes.c_size_t),
        ("sample_time", ctypes.c_double),
        ("voltage", NUMBERS),
        ("current", NUMBERS),
        ("rounding", NUMBERS),
        ("first", ctypes.c_size_t),
        ("whole", ctypes.c_size_t),
        ("periods", ctypes.c_size_t),
        ("early", ctypes.c_bool),
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
        ("saturates", ctypes.c_bool),
        ("current", ctypes.c_double),
        ("psi_rate", ctypes.c_double),
    )


#: A machine with magnets and constant inductances; its rated current scales the saturation.
LINEAR = Machine(None, False, False, 12.0, 0.0)


class Start(ctypes.Structure):
    """What is known before the first row: standard deviations; see engine/innovations.h."""

    _fields_ = (
        *(
            (f"{name}_std", ctypes.c_double)
            for name in ("flux", "angle", "speed", "psi", "acceleration", "drift")
        ),
        ("skipped", ctypes.c_size_t),
    )


class Problem(ctypes.Structure):
    """A log, its machine and the course; see engine/innovations.h."""

    _fields_ = tuple((name, ctypes.c_void_p) for name in ("log", "machine", "start", "course"))


#: The filter before a row, and what it knows at a row; see engine/innovations.h.
FILTER = np.dtype(
    [
        ("x", float, STATES),
        ("P", float, (STATES, STATES)),
        ("by", float, (STATES, SENSITIVE)),
        ("voltage", float, 2),
        ("turning", float),
        ("rotor", float, 2),
        ("row", np.uintp),
        ("square", float),
        ("doubted", np.uintp),
        ("calm", np.uintp),
        ("unknown", np.uintp),
    ]
)
ROW = np.dtype(
    [
        ("own", float, STATES),
        ("current", float, 2),
        ("slope", float, (2, BY)),
        ("P", float, (STATES, STATES)),
        ("error", float, 2),
        ("V", float, (2, 2)),
        ("noise", float, (2, 2)),
        ("K", float, (STATES, 2)),
        ("H", float, (2, BY)),
        ("H_by", float, (2, BY, len(MODEL))),
        ("F", float, ELEMENTS),
        ("F_by", float, (BENT, len(MODEL))),
        ("error_by", float, (2, SENSITIVE)),
        ("moved_by", float, (STATES, SENSITIVE)),
        ("own_by", float, (NOISE, SENSITIVE)),
        ("current_by", float, (2, SENSITIVE)),
        ("measured", bool),
    ],
    align=True,
)
#: A smoothed row; see engine/backward.h.
SMOOTHED = np.dtype([(name, float) for name in ROW_NUMBERS])


class _Outputs(ctypes.Structure):
    _fields_ = (
        *((n, ctypes.c_void_p) for n in ("course", "squares", "smoothed", "covariance", "shares")),
        ("stride", ctypes.c_size_t),
        ("place", ctypes.c_size_t),
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
    #: Rows of the filter, and of the smoother with exact parameters.
    rows: NDArray[np.void]
    smoothed: NDArray[np.void]
    #: The course that smoothing gives.
    next: NDArray[np.void]


@cache
def library(changed: Path | None = None) -> ctypes.CDLL:
    """Compile the engine as a shared library, and load it; a changed source replaces its own."""
    options = ["-std=c99", "-O3", "-ffp-contract=off", "-fPIC", "-shared", f"-I{ENGINE}"]
    options.append(f"-I{FIRMWARE}")
    sources = {path.name: path for path in sorted(ENGINE.glob("*.c"))}
    sources["fluxobs_map.c"] = FIRMWARE / "fluxobs_map.c"
    if changed:
        sources[changed.name] = changed
    with tempfile.TemporaryDirectory() as folder:
        built = build_program(["gcc"], options, list(sources.values()), Path(folder) / "engine.so")
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


def address(values: NDArray[Any]) -> ctypes.c_void_p:
    return ctypes.c_void_p(values.ctypes.data)


def likelihood(
    voltage: Complex,
    current: Complex,
    sample_time: float,
    parameters: Array,
    course: NDArray[np.void],
    start: Start,
    own: ctypes.CDLL | None = None,
    machine: Machine = LINEAR,
    covariance: Array | None = None,
) -> Likelihood:
    """Evaluate a log at the parameters; AssertionError if a number is not finite.

    `covariance` of the parameters: it widens the smoothed rows.
    """
    code, n, out = own or library(), len(current), _Likelihood()
    checkpoints, working = np.zeros(-(-n // CHUNK), FILTER), np.zeros(CHUNK, ROW)
    rows, smoothed, follows = np.zeros(n, ROW), np.zeros(n, SMOOTHED), course.copy()
    p = all_parameters(parameters)
    exact = np.zeros((UNKNOWNS, UNKNOWNS)) if covariance is None else covariance
    with log_of(voltage, current, sample_time) as log:
        parts = [ctypes.cast(ctypes.byref(x), ctypes.c_void_p) for x in (log, machine, start)]
        problem = Problem(*parts, address(course))
        about = (ctypes.byref(problem), pointer(p))
        done = code.fo_innovations(*about, ALL, ctypes.byref(out), address(checkpoints))
        assert done, "the covariance is not positive, or a number is not finite"
        whole = (ctypes.c_size_t(n), ctypes.c_int(KEEP_SENSITIVE), address(rows))
        code.fo_again(*about, address(checkpoints), address(course), *whole)
        back = (address(checkpoints), address(working))
        outputs = _Outputs(None, None, address(smoothed), address(exact), None, 1, 0)
        code.fo_backward(*about, *back, ctypes.byref(outputs), None)
        outputs = _Outputs(address(follows), None, None, None, None, 1, 0)
        code.fo_backward(*about, *back, ctypes.byref(outputs), out.score)
    return Likelihood(
        out.objective,
        np.array(out.score),
        np.array(out.information).reshape(UNKNOWNS, UNKNOWNS),
        out.mean_square,
        rows,
        smoothed,
        follows,
    )


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
        course = got.next
        got = likelihood(voltage, current, sample_time, parameters, course, start, own, machine)
    return got, course
