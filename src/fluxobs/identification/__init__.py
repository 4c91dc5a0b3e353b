"""Parameters of the machine and of its inverter from a whole log."""

from .fitted import Parameter
from .identify import Identification, identify

__all__ = ["Identification", "Parameter", "identify"]
