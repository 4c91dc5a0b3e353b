"""All kinds of machines: a class added here is known to files, commands and the library."""

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
#: Word in a machine file → class.
KINDS = {machine.kind: machine for machine in _KINDS}
