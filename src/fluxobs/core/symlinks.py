"""No link in a folder of results is followed out of it."""

from __future__ import annotations

import os
from pathlib import Path

from ..errors import FluxobsError


def refuse_link(path: Path) -> None:
    """Raise FluxobsError if the path is a link: a folder that was received may hold one that leads
    to another file of the user's."""
    if path.is_symlink():
        raise FluxobsError(f"{path}: is a link, and nothing is written through one; remove it")


def open_own(path: Path) -> int:
    """Descriptor of a file to write in a folder of results: made if missing, never emptied, and
    never what a link points to.

    Raises
    ------
    FluxobsError
        The path is a link, or cannot be written.
    """
    refuse_link(path)
    try:
        # The flag closes the gap since the check, where the platform has it.
        flags = os.O_WRONLY | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)
        return os.open(path, flags | getattr(os, "O_BINARY", 0), 0o666)
    except OSError as error:
        raise FluxobsError(f"{path}: cannot be written: {error.strerror}") from None
