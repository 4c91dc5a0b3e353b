"""Observers in common use, each implemented from its published equations."""

from ...simulation import precision  # noqa: F401  # before anything else: float64
from .back_emf import ExtendedEmf, SlidingMode
from .base import Baseline, Guess, run
from .gradient import ClampedIntegrator, LengthGradient
from .injection import SquareWaveInjection
from .kalman import KalmanFilter
from .regression import OnRegression
from .speed_adaptive import SpeedAdaptiveObserver
from .voltage_model import FilteredVoltageModel

__all__ = [
    "Baseline",
    "ClampedIntegrator",
    "ExtendedEmf",
    "FilteredVoltageModel",
    "Guess",
    "KalmanFilter",
    "LengthGradient",
    "OnRegression",
    "SlidingMode",
    "SpeedAdaptiveObserver",
    "SquareWaveInjection",
    "run",
]
