"""Machines: parameters in SI, the relation between flux and current, and derived quantities."""

from .contract import Machine, Position
from .files import (
    MachineSource,
    as_machine,
    example,
    example_names,
    example_text,
    machine_from,
    read_machine,
)
from .induction import InductionMachine
from .interior_pmsm import InteriorPMSM
from .maglev import MagLev2DOF
from .registry import KINDS
from .rotating import MagnetMachine, RotatingMachine, SynchronousMachine, rotating
from .saturation import AlgebraicSaturation, FluxPoints
from .surface_pmsm import SurfacePMSM
from .synchronous_reluctance import SynchronousReluctance

__all__ = [
    "KINDS",
    "AlgebraicSaturation",
    "FluxPoints",
    "InductionMachine",
    "InteriorPMSM",
    "Machine",
    "MachineSource",
    "MagLev2DOF",
    "MagnetMachine",
    "Position",
    "RotatingMachine",
    "SurfacePMSM",
    "SynchronousMachine",
    "SynchronousReluctance",
    "as_machine",
    "example",
    "example_names",
    "example_text",
    "machine_from",
    "read_machine",
    "rotating",
]
