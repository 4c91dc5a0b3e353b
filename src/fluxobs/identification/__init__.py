"""Parameters of the machine and of its inverter from a whole log."""

from .fit_result import Parameter
from .identify import Identification, identify

__all__ = ["Identification", "Parameter", "identify"]
