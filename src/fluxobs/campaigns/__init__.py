"""Campaigns: thousands of drives simulated within tolerances, each with several observers."""

from .campaign import campaign
from .dataset import Dataset, open_dataset
from .specification import Specification, read_specification

__all__ = ["Dataset", "Specification", "campaign", "open_dataset", "read_specification"]
