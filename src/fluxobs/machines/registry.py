"""Every kind of machine: add a class here, and files, commands and the library know it."""

from __future__ import annotations

from .contract import Machine
from .interior_pmsm import InteriorPMSM
from .maglev import MagLev2DOF
from .surface_pmsm import SurfacePMSM
from .synchronous_reluctance import SynchronousReluctance

_KINDS: tuple[type[Machine], ...] = (SurfacePMSM, InteriorPMSM, SynchronousReluctance, MagLev2DOF)
#: By the word that stands in a machine file.
KINDS = {machine.kind: machine for machine in _KINDS}
