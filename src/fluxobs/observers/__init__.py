"""The estimators."""

from .base import Estimate, Observer
from .least_squares import LeastSquaresObserver, LeastSquaresState, SampleCounts

__all__ = ["Estimate", "LeastSquaresObserver", "LeastSquaresState", "Observer", "SampleCounts"]
