"""Work in many processes, on one machine or a cluster, that a kill does not lose.

A task writes its result itself, whole or not at all; what is written is the checkpoint.
"""

from .compute import LOCAL, POOL, compute
from .folder import locked, write_part

__all__ = ["LOCAL", "POOL", "compute", "locked", "write_part"]
