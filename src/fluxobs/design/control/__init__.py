"""Controllers for the simulated machines."""

from .ida_pbc import IdaPbc

__all__ = ["IdaPbc"]
