"""Observers on the paper's regression: as printed, repaired, and those it argues against."""

from .base import ContinuousObserver, FluxObserver, flow_gain, run
from .drem import DremObserver
from .gradient import PrintedAdaptiveObserver, RepairedAdaptiveObserver, RobustObserver
from .open_loop import PEBO, VoltageModel
from .riccati import RiccatiObserver

__all__ = [
    "PEBO",
    "ContinuousObserver",
    "DremObserver",
    "FluxObserver",
    "PrintedAdaptiveObserver",
    "RepairedAdaptiveObserver",
    "RiccatiObserver",
    "RobustObserver",
    "VoltageModel",
    "flow_gain",
    "run",
]
