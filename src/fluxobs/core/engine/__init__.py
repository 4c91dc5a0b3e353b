"""Run tasks in many processes, on one machine or a cluster; a killed run can resume.

Each task writes its own result, complete or not at all; the written files are the checkpoint.
"""

from .compute import LOCAL, POOL, compute
from .folder import locked, write_part

__all__ = ["LOCAL", "POOL", "compute", "locked", "write_part"]
