"""Observers in Python, in C and in simulation units, with a single interface: a step a sample.

:mod:`fluxobs.benchmark.entrants` describes what each must provide.
"""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
import shutil
import tomllib
import weakref
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ..core.arrays import Array
from ..errors import FluxobsError
from ..machines import RotatingMachine, as_machine, rotating

#: Order of what an observer returns.
OUTPUTS = ("theta_e", "theta_e_std", "valid", "speed_e", "torque")
LIBRARIES = (".so", ".dll", ".dylib")
UNIT = ".fmu"


class Stepped(Protocol):
    """A causal observer."""

    def step(self, voltage: Array, current: Array) -> Any:
        """Return theta_e, or the first of OUTPUTS as a tuple."""


#: Creates an observer for a machine file and a sample time [s]; None: it has none for this machine.
Create = Callable[[Path, float], Stepped | None]


def fields_of(path: Path) -> dict[str, Any]:
    """Return the fields of a machine file as an observer in Python gets them.

    Inductances and magnet flux of a machine with a flux map are those at the rated current.
    """
    fields = tomllib.loads(path.read_text("utf-8"))
    machine: RotatingMachine = rotating(as_machine(path), "a benchmark")
    if isinstance(fields.get("flux_map"), str):
        fields["flux_map"] = str((path.parent / fields["flux_map"]).resolve())
    known = dict(zip(machine.inductances, machine.L_dq, strict=True))
    if machine.magnets and machine.magnet_flux is not None:
        known["psi_f"] = machine.magnet_flux
    return {**known, **fields}


def in_python(text: str) -> Callable[[Mapping[str, Any], float], Any]:
    """Return the class or function that ``FILE.py:NAME`` or ``module:NAME`` names.

    Raises
    ------
    FluxobsError
        It cannot be imported.
    """
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


class _InC:
    """An observer of a shared library."""

    def __init__(self, library: Any, path: Path, sample_time: float) -> None:
        kind = ctypes.c_double * 2
        self._step, self._estimate = library.observer_step, (ctypes.c_double * len(OUTPUTS))()
        self._voltage, self._current = kind(), kind()
        self._observer = library.observer_new(str(path.resolve()).encode(), sample_time)
        if not self._observer:
            raise FluxobsError(f"{path.name}: observer_new returned NULL")
        weakref.finalize(self, library.observer_free, self._observer)

    def step(self, voltage: Array, current: Array) -> tuple[float, ...]:
        """Step the observer."""
        self._voltage[0], self._voltage[1] = voltage
        self._current[0], self._current[1] = current
        self._step(self._observer, self._voltage, self._current, self._estimate)
        return tuple(self._estimate)


def in_c(path: Path) -> Create:
    """Return how a shared library creates an observer.

    Raises
    ------
    FluxobsError
        It cannot be loaded, or lacks a function.
    """
    try:
        library = ctypes.CDLL(str(path.resolve()))
        library.observer_new.restype = ctypes.c_void_p
        library.observer_new.argtypes = [ctypes.c_char_p, ctypes.c_double]
        library.observer_free.argtypes = [ctypes.c_void_p]
        library.observer_step.argtypes = [ctypes.c_void_p, *[ctypes.POINTER(ctypes.c_double)] * 3]
    except (OSError, AttributeError) as error:
        raise FluxobsError(f"{path}: {error}") from None
    return lambda machine, sample_time: _InC(library, machine, sample_time)


class _Unit:
    """A simulation unit for co-simulation (FMI 2 or 3)."""

    def __init__(self, path: Path, sample_time: float) -> None:
        import fmpy
        from fmpy import fmi2, fmi3

        description = fmpy.read_model_description(str(path))
        three = description.fmiVersion.startswith("3")
        folder = fmpy.extract(str(path))
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        kind = fmi3.FMU3Slave if three else fmi2.FMU2Slave
        unit = kind(
            guid=description.guid,
            unzipDirectory=folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="observer",
        )
        variables = {variable.name: variable for variable in description.modelVariables}
        inputs = ("u_alpha", "u_beta", "i_alpha", "i_beta")
        lacking = [name for name in (*inputs, OUTPUTS[0]) if name not in variables]
        if lacking:
            raise FluxobsError(f"{path}: the unit has no variable {', '.join(lacking)}")
        unit.instantiate()
        if three:
            unit.enterInitializationMode()
            self._set, self._get, booleans = unit.setFloat64, unit.getFloat64, unit.getBoolean
        else:
            unit.setupExperiment()
            unit.enterInitializationMode()
            self._set, self._get, booleans = unit.setReal, unit.getReal, unit.getBoolean
        unit.exitInitializationMode()
        self._unit, self._steps, self._sample_time = unit, 0, sample_time
        self._inputs = [variables[name].valueReference for name in inputs]
        self._outputs = [
            (
                booleans if variables[name].type == "Boolean" else self._get,
                [variables[name].valueReference],
            )
            if name in variables
            else None
            for name in OUTPUTS
        ]

    def step(self, voltage: Array, current: Array) -> tuple[float, ...]:
        """Set the inputs, do a communication step, and read the outputs."""
        self._set(self._inputs, [*map(float, voltage), *map(float, current)])
        self._unit.doStep(
            currentCommunicationPoint=self._steps * self._sample_time,
            communicationStepSize=self._sample_time,
        )
        self._steps += 1
        return tuple(
            np.nan if output is None else float(output[0](output[1])[0]) for output in self._outputs
        )


def in_units(path: Path) -> Create:
    """Return how a unit, or a folder of units, creates an observer.

    A unit is made for a machine, whose name is the beginning of its file's name; other machines
    have no observer then.

    Raises
    ------
    FluxobsError
        The package fmpy is not installed.
    """
    if importlib.util.find_spec("fmpy") is None:
        raise FluxobsError(f"{path}: needs the package fmpy (pip install 'fluxobs[fmu]')")
    units = sorted(path.glob(f"*{UNIT}")) if path.is_dir() else [path]

    def create(machine: Path, sample_time: float) -> Stepped | None:
        own = [unit for unit in units if unit.name.startswith(f"{machine.stem}.")]
        return _Unit(own[0], sample_time) if own else None

    return create
