"""Entrants: what a benchmark scores, whoever wrote it.

An entrant is

- the name of one of our observers: ``plain``, ``adaptive`` (causal) or ``whole-log`` (offline);
- the name of a published observer, as ``fluxobs compare`` lists them;
- ``FILE.py:NAME`` or ``module:NAME``, a class or function in Python;
- a shared library (.so, .dll, .dylib) with the C functions below;
- a folder of estimates, ``RECORD.parquet`` with the columns of :class:`Estimates`.

In Python, ``NAME(machine, sample_time)`` returns an object; `machine` is the machine file as a
mapping. If it has ``step(voltage, current)``, the track is causal: called once a sample with the
mean voltage since the sample before and the current now, both α and β, it returns theta_e, or a
tuple (theta_e, theta_e_std, valid, speed_e, torque) as long as it likes. If it has
``estimate(voltage, current)``, the track is offline: called with all rows at once, it returns a
mapping. The C functions are

    void *observer_new(const char *machine_file, double sample_time);
    void observer_step(void *observer, const double voltage[2], const double current[2],
                       double estimate[5]);
    void observer_free(void *observer);

`estimate` has the same order; what an observer does not know is NaN, valid is 0 or 1.
"""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
import time
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ..core.arrays import Array
from ..core.validation import nearest
from ..errors import FluxobsError
from ..estimation.lag import shifted
from ..machines import example, rotating
from .draws import MACHINES
from .suite import Entry, Suite

Track = Literal["offline", "causal"]
#: Our observers with their tracks.
OURS: dict[str, Track] = {"plain": "causal", "adaptive": "causal", "whole-log": "offline"}
#: Order of what an entrant returns.
OUTPUTS = ("theta_e", "theta_e_std", "valid", "speed_e", "torque")
LIBRARIES = (".so", ".dll", ".dylib")


class Estimates(NamedTuple):
    """Estimates of a record, (rows,) each; None if the entrant does not state them.

    Attributes
    ----------
    theta_e, theta_e_std : ndarray
        Electrical position and its standard deviation [rad].
    valid : ndarray of bool
    speed_e, torque : ndarray
        [rad/s], [N m].
    seconds : float
        Time per sample; NaN for a folder of estimates.
    """

    theta_e: Array
    theta_e_std: Array | None = None
    valid: NDArray[Any] | None = None
    speed_e: Array | None = None
    torque: Array | None = None
    seconds: float = float("nan")


@dataclass(frozen=True)
class Entrant:
    """An entrant.

    Attributes
    ----------
    name : str
    track : "offline" or "causal"
    run : callable
        Estimates a record; None if the entrant has no observer for this machine.
    """

    name: str
    track: Track
    run: Callable[[Suite, Entry], Estimates | None]


def entrant(text: str, track: Track | None = None) -> Entrant:
    """Return the entrant that a text names; `track` is that of a folder of estimates.

    Raises
    ------
    FluxobsError
        There is no such entrant.
    """
    path = Path(text)
    if text in OURS:
        return Entrant(text, OURS[text], lambda suite, entry: _own(text, suite, entry))
    if path.is_dir():
        if track is None:
            raise FluxobsError(f"{text}: state the track of a folder of estimates: --track")
        return Entrant(path.name, track, lambda suite, entry: _stored(path, entry))
    if path.suffix in LIBRARIES:
        library = _library(path)
        return Entrant(path.stem, "causal", lambda suite, entry: _in_c(library, suite, entry))
    if ":" in text:
        make = _python(text)
        probe = make(
            {"kind": "surface-pmsm", "R_s": 1.0, "L_s": 1e-3, "n_p": 1, "psi_f": 0.1}, 1e-4
        )
        name = text.rpartition(":")[2]
        if hasattr(probe, "step"):
            return Entrant(name, "causal", lambda suite, entry: _stepped(make, suite, entry))
        if hasattr(probe, "estimate"):
            return Entrant(name, "offline", lambda suite, entry: _at_once(make, suite, entry))
        raise FluxobsError(f"{text}: what it returns has neither step nor estimate")
    if text not in published():
        known = (*OURS, *published(), "FILE.py:NAME", "LIBRARY.so", "FOLDER")
        raise FluxobsError(f"entrant {text!r} is unknown{nearest(text, known)}")
    return Entrant(text, "causal", lambda suite, entry: _published(text, suite, entry))


def published() -> tuple[str, ...]:
    """Return the names of the published observers, of any machine of the suite."""
    from ..comparison.cages import entries_for

    machines = (rotating(example(name), "a benchmark") for name in MACHINES)
    names = [
        found.name
        for machine in machines
        for found in entries_for(machine)
        if not found.least_squares
    ]
    return tuple(dict.fromkeys(names))


def _own(name: str, suite: Suite, entry: Entry) -> Estimates:
    from ..presentation.estimate import estimate

    began = time.perf_counter()
    result = estimate(
        suite.log(entry),
        suite.machine(entry),
        sample_time=entry.sample_time,
        lag=0,
        causal=name != "whole-log",
        unknowns="drift" if name == "plain" else "auto",
    )
    seconds = (time.perf_counter() - began) / len(result["t"])
    return _named({output: result[output] for output in OUTPUTS}, seconds)


def _published(name: str, suite: Suite, entry: Entry) -> Estimates | None:
    from ..campaigns.drives import cell_of
    from ..campaigns.observed import NOISE, candidate, observe
    from ..campaigns.specification import ObserverTable, Specification
    from ..comparison.cages import entries_for
    from ..comparison.compare import hold_last

    specification = Specification.model_validate(
        {"name": "benchmark", "scenarios": 1, "machines": [entry.machine], "observers": [name]}
    )
    cell = cell_of(specification, entry.machine)
    if name not in {found.name for found in entries_for(cell.machine)}:
        return None
    observer = candidate(ObserverTable(kind=name), cell, NOISE * cell.current)
    voltage, current = suite.log(entry)
    held = hold_last(current)
    began = time.perf_counter()
    (record,) = observe(observer, shifted(voltage, -1)[None], held[None], ())
    seconds = (time.perf_counter() - began) / len(voltage)
    return Estimates(record.theta_e, None, record.valid, record.speed_e, None, seconds)


def _stored(folder: Path, entry: Entry) -> Estimates:
    path = folder / f"{entry.name}.parquet"
    try:
        table = pl.read_parquet(path)
    except (OSError, pl.exceptions.PolarsError) as error:
        raise FluxobsError(f"{path}: {error}") from None
    if "theta_e" not in table.columns:
        raise FluxobsError(f"{path}: has no column theta_e")
    return _named({name: table[name].to_numpy() for name in OUTPUTS if name in table.columns})


def _python(text: str) -> Callable[[Mapping[str, Any], float], Any]:
    place, _, name = text.rpartition(":")
    try:
        if place.endswith(".py"):
            specification = importlib.util.spec_from_file_location(Path(place).stem, place)
            assert specification is not None
            assert specification.loader is not None
            module = importlib.util.module_from_spec(specification)
            specification.loader.exec_module(module)
        else:
            module = importlib.import_module(place)
    except (OSError, ImportError) as error:
        raise FluxobsError(f"{text}: {error}") from None
    if not hasattr(module, name):
        raise FluxobsError(f"{text}: {place} has no {name}")
    made: Callable[[Mapping[str, Any], float], Any] = getattr(module, name)
    return made


def _file(suite: Suite, entry: Entry) -> dict[str, Any]:
    return tomllib.loads((suite.folder / "machines" / f"{entry.machine}.toml").read_text("utf-8"))


def _stepped(make: Callable[..., Any], suite: Suite, entry: Entry) -> Estimates:
    voltage, current = suite.log(entry)
    observer = make(_file(suite, entry), entry.sample_time)
    rows = list(zip(shifted(voltage, -1), current, strict=True))
    began = time.perf_counter()
    got = [observer.step(u, i) for u, i in rows]
    seconds = (time.perf_counter() - began) / len(rows)
    width = len(got[0]) if isinstance(got[0], tuple) else 1
    values = np.array(got, float).reshape(len(rows), width)
    return _ordered([values[:, k] for k in range(width)], seconds)


def _at_once(make: Callable[..., Any], suite: Suite, entry: Entry) -> Estimates:
    voltage, current = suite.log(entry)
    began = time.perf_counter()
    got = make(_file(suite, entry), entry.sample_time).estimate(voltage, current)
    seconds = (time.perf_counter() - began) / len(voltage)
    return _named({name: got[name] for name in OUTPUTS if name in got}, seconds)


def _library(path: Path) -> Any:
    try:
        library = ctypes.CDLL(str(path.resolve()))
        library.observer_new.restype = ctypes.c_void_p
        library.observer_new.argtypes = [ctypes.c_char_p, ctypes.c_double]
        library.observer_free.argtypes = [ctypes.c_void_p]
        library.observer_step.argtypes = [ctypes.c_void_p, *[ctypes.POINTER(ctypes.c_double)] * 3]
    except (OSError, AttributeError) as error:
        raise FluxobsError(f"{path}: {error}") from None
    return library


def _in_c(library: Any, suite: Suite, entry: Entry) -> Estimates:
    voltage, current = (np.ascontiguousarray(v, float) for v in suite.log(entry))
    voltage = shifted(voltage, -1)
    estimates = np.zeros((len(voltage), len(OUTPUTS)))
    machine = str((suite.folder / "machines" / f"{entry.machine}.toml").resolve()).encode()
    observer = library.observer_new(machine, entry.sample_time)
    if not observer:
        raise FluxobsError(f"{entry.name}: observer_new returned NULL")

    def pointers(values: Array) -> list[Any]:
        kind = ctypes.POINTER(ctypes.c_double)
        return [row.ctypes.data_as(kind) for row in values]

    rows = list(zip(pointers(voltage), pointers(current), pointers(estimates), strict=True))
    began = time.perf_counter()
    for row in rows:
        library.observer_step(observer, *row)
    seconds = (time.perf_counter() - began) / len(rows)
    library.observer_free(observer)
    return _ordered(list(estimates.T), seconds)


def _ordered(values: list[Array], seconds: float) -> Estimates:
    """Return estimates in the order of OUTPUTS; what is NaN throughout is not stated."""
    named = dict(zip(OUTPUTS, values, strict=False))
    stated: dict[str, Any] = {
        name: column
        for name, column in named.items()
        if name == OUTPUTS[0] or not np.isnan(column).all()
    }
    if "valid" in stated:
        stated["valid"] = stated["valid"] > 0.5
    return _named(stated, seconds)


def _named(columns: Mapping[str, Any], seconds: float = float("nan")) -> Estimates:
    return Estimates(**columns, seconds=seconds)
