"""The observers and the list of their outputs."""

from .adaptive import AdaptiveEstimate, AdaptiveObserver, Priors
from .base import Estimate, LogObserver, Observer, SampleCounts
from .compiled import CompiledState
from .immersed import ImmersionEstimate, ImmersionObserver, ImmersionState
from .outputs import Output, in_files, outputs
from .plain import LeastSquaresObserver

__all__ = [
    "AdaptiveEstimate",
    "AdaptiveObserver",
    "CompiledState",
    "Estimate",
    "ImmersionEstimate",
    "ImmersionObserver",
    "ImmersionState",
    "LeastSquaresObserver",
    "LogObserver",
    "Observer",
    "Output",
    "Priors",
    "SampleCounts",
    "in_files",
    "outputs",
]
