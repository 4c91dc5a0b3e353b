"""The main job: a log in; flux, position, speed, drift and how far to trust them out."""

from .estimate import estimate
from .result import Result

__all__ = ["Result", "estimate"]
