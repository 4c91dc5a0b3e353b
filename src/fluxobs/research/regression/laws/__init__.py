"""Observers on the paper's regression: printed, repaired, and those the paper argues against."""

from .base import ContinuousObserver, FluxObserver, flow_gain, integrate_law, run
from .drem import DremObserver
from .gpebo import GeneralisedPEBO
from .gradient import PrintedAdaptiveObserver, RepairedAdaptiveObserver, RobustObserver
from .open_loop import PEBO, VoltageModel
from .riccati import RiccatiObserver

__all__ = [
    "PEBO",
    "ContinuousObserver",
    "DremObserver",
    "FluxObserver",
    "GeneralisedPEBO",
    "PrintedAdaptiveObserver",
    "RepairedAdaptiveObserver",
    "RiccatiObserver",
    "RobustObserver",
    "VoltageModel",
    "flow_gain",
    "integrate_law",
    "run",
]
