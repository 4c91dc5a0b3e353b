"""Parameters of the machine and of its inverter from a whole log, and what is wrong with a log."""

from .check import Check, Finding, check
from .fitted import Parameter
from .identify import Identification, identify

__all__ = ["Check", "Finding", "Identification", "Parameter", "check", "identify"]
