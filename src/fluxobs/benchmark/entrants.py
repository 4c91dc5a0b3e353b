"""Entrants: what a benchmark scores, whoever wrote it.

An entrant is

- the name of one of our observers: ``plain``, ``adaptive`` (causal) or ``whole-log`` (offline);
- the name of a published observer, as ``fluxobs compare`` lists them;
- ``FILE.py:NAME`` or ``module:NAME``, a class or function in Python;
- a shared library (.so, .dll, .dylib) with the C functions below;
- a simulation unit ``MACHINE*.fmu`` (FMI 2 or 3, co-simulation), or a folder of them;
- a folder of estimates, ``RECORD.parquet`` with the columns of :class:`Estimates`.

In Python, ``NAME(machine, sample_time)`` returns an object; `machine` is the machine file as a
mapping. If it has ``step(voltage, current)``, it is causal: called once a sample with the mean
voltage since the sample before and the current now, both α and β, it returns theta_e, or a tuple
(theta_e, theta_e_std, valid, speed_e, torque) as long as it likes. If it has
``estimate(voltage, current)``, it is offline: called with all rows at once, it returns a mapping.
The C functions are

    void *observer_new(const char *machine_file, double sample_time);
    void observer_step(void *observer, const double voltage[2], const double current[2],
                       double estimate[5]);
    void observer_free(void *observer);

`estimate` has the same order; what an observer does not know is NaN, valid is 0 or 1. A unit has
the inputs u_alpha, u_beta, i_alpha, i_beta and outputs with these names.
"""

from __future__ import annotations

import time
import tomllib
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
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
from ..machines import example, example_text, rotating
from .draws import MACHINES
from .programs import (
    LIBRARIES,
    OUTPUTS,
    UNIT,
    Create,
    Stepped,
    fields_of,
    in_c,
    in_python,
    in_units,
)
from .suite import Entry, Suite

Track = Literal["offline", "causal", "closed-loop"]
#: Our observers with their tracks.
OURS: dict[str, Track] = {"plain": "causal", "adaptive": "causal", "whole-log": "offline"}
#: Machine for which a function is called to see whether it returns a causal observer.
SURFACE = tomllib.loads(example_text("servo-400w"))


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
    create : callable, optional
        Creates an observer that can be in the loop of a drive.
    """

    name: str
    track: Track
    run: Callable[[Suite, Entry], Estimates | None]
    create: Create | None = None

    @classmethod
    def causal(cls, name: str, create: Create) -> Entrant:
        """Return a causal entrant that creates its observers."""
        return cls(name, "causal", lambda suite, entry: _stepped(create, suite, entry), create)


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
    if path.suffix == UNIT or (path.is_dir() and any(path.glob(f"*{UNIT}"))):
        return Entrant.causal(path.stem, in_units(path))
    if path.is_dir():
        if track is None:
            raise FluxobsError(f"{text}: state the track of a folder of estimates: --track")
        return Entrant(path.name, track, lambda suite, entry: _stored(path, entry))
    if path.suffix in LIBRARIES:
        return Entrant.causal(path.stem, in_c(path))
    if ":" in text:
        make = in_python(text)
        with _errors_of(None, text):
            observer = make if isinstance(make, type) else make(SURFACE, 1e-4)
        name = text.rpartition(":")[2]
        if hasattr(observer, "step"):
            return Entrant.causal(name, lambda machine, h: _created(make, machine, h))
        if hasattr(observer, "estimate"):
            return Entrant(name, "offline", lambda suite, entry: _at_once(make, suite, entry))
        raise FluxobsError(f"{text}: what it returns has neither step nor estimate")
    if text not in published():
        known = (*OURS, *published(), "FILE.py:NAME", "LIBRARY.so", "MACHINE.fmu", "FOLDER")
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

    machine = str(suite.machine_file(entry)) if suite.measured else entry.machine
    specification = Specification.model_validate(
        {
            **{"name": "benchmark", "scenarios": 1, "machines": [machine], "observers": [name]},
            "drive": suite.ratings.get(entry.machine, {}),
        }
    )
    cell = cell_of(specification, machine)
    if name not in {found.name for found in entries_for(cell.machine)}:
        return None
    observer = candidate(ObserverTable(kind=name), cell, NOISE * cell.current)
    voltage, current = suite.log(entry)
    log = shifted(voltage, -1)[None], hold_last(current)[None]
    for _ in range(2):  # the first run contains the time of the compilation
        began = time.perf_counter()
        (record,) = observe(observer, *log, ())
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


@contextmanager
def _errors_of(entry: Entry | None, name: str) -> Iterator[None]:
    """Turn an exception of an entrant into an error that names record, file and line."""
    try:
        yield
    except FluxobsError:
        raise
    except Exception as error:
        at = traceback.extract_tb(error.__traceback__)[-1]
        where = "" if entry is None else f"{entry.name}: "
        raise FluxobsError(
            f"{where}{name} failed at {at.filename}:{at.lineno}: {type(error).__name__}: {error}"
        ) from error


def _created(make: Callable[..., Any], machine: Path, sample_time: float) -> Stepped:
    observer: Stepped = make(fields_of(machine), sample_time)
    return observer


def _stepped(create: Create, suite: Suite, entry: Entry) -> Estimates | None:
    voltage, current = suite.log(entry)
    with _errors_of(entry, "the entrant"):
        observer = create(suite.machine_file(entry), entry.sample_time)
        if observer is None:
            return None
        rows = list(zip(shifted(voltage, -1), current, strict=True))
        began = time.perf_counter()
        got = [observer.step(u, i) for u, i in rows]
        seconds = (time.perf_counter() - began) / len(rows)
    width = len(got[0]) if isinstance(got[0], tuple) else 1
    try:
        values = np.array(got, float).reshape(len(rows), width)
    except (TypeError, ValueError):
        values = np.empty((0, 0))
    if len(values) != len(rows) or not 1 <= width <= len(OUTPUTS) or got[0] is None:
        raise FluxobsError(
            f"{entry.name}: step must return theta_e, or a tuple of one to {len(OUTPUTS)} numbers "
            f"({', '.join(OUTPUTS)}), each time alike; got {got[0]!r}"
        )
    return _ordered([values[:, k] for k in range(width)], seconds)


def _at_once(make: Callable[..., Any], suite: Suite, entry: Entry) -> Estimates:
    voltage, current = suite.log(entry)
    began = time.perf_counter()
    fields = fields_of(suite.machine_file(entry))
    with _errors_of(entry, "the entrant"):
        got = make(fields, entry.sample_time).estimate(voltage, current)
    seconds = (time.perf_counter() - began) / len(voltage)
    if not isinstance(got, Mapping) or OUTPUTS[0] not in got:
        raise FluxobsError(f"{entry.name}: estimate must return a mapping with theta_e")
    return _named({name: got[name] for name in OUTPUTS if name in got}, seconds)


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
