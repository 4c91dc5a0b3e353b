"""The estimators."""

from .base import Estimate, Observer
from .least_squares import LeastSquaresObserver, LeastSquaresState, SampleCounts
from .reference import ImmersionEstimate, ImmersionObserver, ImmersionState

__all__ = [
    "Estimate",
    "ImmersionEstimate",
    "ImmersionObserver",
    "ImmersionState",
    "LeastSquaresObserver",
    "LeastSquaresState",
    "Observer",
    "SampleCounts",
]
