"""Identification of machine and inverter parameters from whole logs."""

from .identify import Identification, identify
from .values import Parameter

__all__ = ["Identification", "Parameter", "identify"]
