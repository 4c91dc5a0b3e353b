"""Estimate flux, position, speed and drift from a log, with standard deviations."""

from .estimate import estimate
from .result import Result

__all__ = ["Result", "estimate"]
