"""Work in many processes, on one machine or a cluster, that survives a kill.

Each task writes its own result, complete or not at all; the files written are the checkpoint.
"""

from .compute import LOCAL, POOL, compute
from .folder import locked, write_part

__all__ = ["LOCAL", "POOL", "compute", "locked", "write_part"]
