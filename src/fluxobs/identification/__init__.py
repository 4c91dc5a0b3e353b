"""Identification of machine and inverter parameters from whole logs."""

from .fit_result import Parameter
from .identify import Identification, identify

__all__ = ["Identification", "Parameter", "identify"]
