"""Parameters of the machine and of its inverter from a whole log, offline."""

from .identify import Identification, Parameter, identify

__all__ = ["Identification", "Parameter", "identify"]
