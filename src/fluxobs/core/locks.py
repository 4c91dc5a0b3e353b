"""Locks on files that only one process at a time may use."""

from __future__ import annotations

import os
from pathlib import Path


def lock(descriptor: int) -> bool:
    """Lock a file until its descriptor is closed or the process ends.

    Returns False if another process holds the lock. True where locks do not exist (Windows, some
    network file systems).
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
    """Whether the path still names the open file, which another process may have replaced."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.lstat())
    except FileNotFoundError:
        return False
