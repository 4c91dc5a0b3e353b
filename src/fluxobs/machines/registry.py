"""All kinds of machines: add a class here to use it in files, commands and the library."""

from __future__ import annotations

from .contract import Machine
from .induction import InductionMachine
from .interior_pmsm import InteriorPMSM
from .maglev import MagLev2DOF
from .surface_pmsm import SurfacePMSM
from .synchronous_reluctance import SynchronousReluctance

_KINDS: tuple[type[Machine], ...] = (
    SurfacePMSM,
    InteriorPMSM,
    SynchronousReluctance,
    InductionMachine,
    MagLev2DOF,
)
#: Class of a machine, by its kind in a machine file.
KINDS = {machine.kind: machine for machine in _KINDS}
