"""The estimators."""

from .adaptive import AdaptiveEstimate, AdaptiveObserver
from .base import Estimate, Observer
from .least_squares import LeastSquaresObserver, LeastSquaresState, SampleCounts
from .reference import ImmersionEstimate, ImmersionObserver, ImmersionState

__all__ = [
    "AdaptiveEstimate",
    "AdaptiveObserver",
    "Estimate",
    "ImmersionEstimate",
    "ImmersionObserver",
    "ImmersionState",
    "LeastSquaresObserver",
    "LeastSquaresState",
    "Observer",
    "SampleCounts",
]
