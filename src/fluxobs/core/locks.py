"""Files on which one process at a time works."""

from __future__ import annotations

import os
from pathlib import Path


def lock(descriptor: int) -> bool:
    """Lock a file until its descriptor is closed, at the latest when the process ends.

    Returns False if somebody else holds it. Where there are no locks (Windows, some network file
    systems) it returns True: nobody is known to hold it.
    """
    try:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except (ImportError, OSError):
        pass
    return True


def is_at(descriptor: int, path: Path) -> bool:
    """Whether the path still names the open file: somebody may have removed or replaced it."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.lstat())
    except FileNotFoundError:
        return False
