"""Fleets: many logs estimated together, and their parameters followed over time."""

from .batch import Fleet, estimate_many, open_fleet

__all__ = ["Fleet", "estimate_many", "open_fleet"]
