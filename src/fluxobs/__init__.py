"""Magnetic flux, rotor position, speed and sensor drift of electrical drives."""

from importlib.metadata import version

from .constraint import QuadraticConstraint
from .deployment import export
from .errors import FluxobsError, MachineError, ModelError, RecordError
from .immersion import Immersion
from .machines import (
    InteriorPMSM,
    Machine,
    MagLev2DOF,
    SurfacePMSM,
    SynchronousReluctance,
    read_machine,
)
from .observers import AdaptiveObserver, Estimate, ImmersionObserver, LeastSquaresObserver
from .records import Record

__version__ = version("fluxobs")

__all__ = [
    "AdaptiveObserver",
    "Estimate",
    "FluxobsError",
    "Immersion",
    "ImmersionObserver",
    "InteriorPMSM",
    "LeastSquaresObserver",
    "Machine",
    "MachineError",
    "MagLev2DOF",
    "ModelError",
    "QuadraticConstraint",
    "Record",
    "RecordError",
    "SurfacePMSM",
    "SynchronousReluctance",
    "export",
    "read_machine",
]
