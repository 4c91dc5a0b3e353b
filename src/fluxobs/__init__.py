"""Estimate magnetic flux, rotor position, speed and sensor drift of electrical drives.

The command line calls :func:`estimate`, :func:`identify`, :func:`check`, :func:`compare` and
:func:`export`; :func:`read_log`, :func:`read_machine`, :func:`example` and :func:`demo_log` provide
their input. The observers work sample by sample.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from .errors import (
    FluxobsError,
    MachineError,
    ModelError,
    ObserverError,
    RecordError,
    UsageError,
)
from .logs.record import Record
from .machines import (
    InductionMachine,
    InteriorPMSM,
    Machine,
    MagLev2DOF,
    SurfacePMSM,
    SynchronousReluctance,
    example,
    read_machine,
)
from .machines.model.constraint import QuadraticConstraint
from .machines.model.immersion import Immersion
from .observers import AdaptiveObserver, Estimate, ImmersionObserver, LeastSquaresObserver

if TYPE_CHECKING:
    from .campaigns.campaign import campaign
    from .comparison.compare import compare
    from .deployment.export import export
    from .examination.examine import check
    from .identification.identify import identify
    from .logs import Log, read_log
    from .presentation.estimate import estimate
    from .presentation.result import Result
    from .simulation.closed_form.demo import demo_log

__version__ = version("fluxobs")

#: Names loaded on first use, since they import file readers; compare and campaign also import JAX.
_LATER = {
    "Log": "logs",
    "Result": "presentation.result",
    "campaign": "campaigns.campaign",
    "check": "examination.examine",
    "compare": "comparison.compare",
    "demo_log": "simulation.closed_form.demo",
    "estimate": "presentation.estimate",
    "export": "deployment.export",
    "identify": "identification.identify",
    "read_log": "logs",
}

__all__ = [
    "AdaptiveObserver",
    "Estimate",
    "FluxobsError",
    "Immersion",
    "ImmersionObserver",
    "InductionMachine",
    "InteriorPMSM",
    "LeastSquaresObserver",
    "Log",
    "Machine",
    "MachineError",
    "MagLev2DOF",
    "ModelError",
    "ObserverError",
    "QuadraticConstraint",
    "Record",
    "RecordError",
    "Result",
    "SurfacePMSM",
    "SynchronousReluctance",
    "UsageError",
    "campaign",
    "check",
    "compare",
    "demo_log",
    "estimate",
    "example",
    "export",
    "identify",
    "read_log",
    "read_machine",
]


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f".{_LATER[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
