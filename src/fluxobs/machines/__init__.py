"""Machines: parameters in SI, their constraint, R and B."""

from .base import Machine
from .files import KINDS, example, example_names, example_text, machine_from, read_machine
from .interior_pmsm import InteriorPMSM
from .surface_pmsm import SurfacePMSM
from .synchronous_reluctance import SynchronousReluctance

__all__ = [
    "KINDS",
    "InteriorPMSM",
    "Machine",
    "SurfacePMSM",
    "SynchronousReluctance",
    "example",
    "example_names",
    "example_text",
    "machine_from",
    "read_machine",
]
