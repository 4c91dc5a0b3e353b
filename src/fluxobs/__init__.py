"""Magnetic flux, rotor position, speed and sensor drift of electrical drives."""

from importlib.metadata import version

from .constraint import QuadraticConstraint
from .errors import FluxobsError, MachineError, RecordError
from .machines import InteriorPMSM, Machine, SurfacePMSM, SynchronousReluctance, read_machine
from .observers import Estimate, LeastSquaresObserver
from .records import Record

__version__ = version("fluxobs")

__all__ = [
    "Estimate",
    "FluxobsError",
    "InteriorPMSM",
    "LeastSquaresObserver",
    "Machine",
    "MachineError",
    "QuadraticConstraint",
    "Record",
    "RecordError",
    "SurfacePMSM",
    "SynchronousReluctance",
    "read_machine",
]
