"""Machines: parameters in SI, their constraint, R and B."""

from .base import Machine, RotatingMachine
from .files import KINDS, example, example_names, example_text, machine_from, read_machine
from .interior_pmsm import InteriorPMSM
from .maglev import MagLev2DOF
from .surface_pmsm import SurfacePMSM
from .synchronous_reluctance import SynchronousReluctance

__all__ = [
    "KINDS",
    "InteriorPMSM",
    "Machine",
    "MagLev2DOF",
    "RotatingMachine",
    "SurfacePMSM",
    "SynchronousReluctance",
    "example",
    "example_names",
    "example_text",
    "machine_from",
    "read_machine",
]
