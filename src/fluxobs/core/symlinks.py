"""Refuse links in a folder of results, because links may lead out of the folder."""

from __future__ import annotations

import os
from pathlib import Path

from ..errors import FluxobsError


def refuse_link(path: Path) -> None:
    """Raise FluxobsError if the path is a link.

    A received folder may contain links to other files of the user.
    """
    if path.is_symlink():
        raise FluxobsError(
            f"{path}: is a link; remove the link, results are not written through it"
        )


def open_own(path: Path) -> int:
    """Open a file for writing in a folder of results; return its descriptor.

    The file is created if missing and never truncated. A link is never followed.

    Raises
    ------
    FluxobsError
        The path is a link, or cannot be written.
    """
    refuse_link(path)
    try:
        # O_NOFOLLOW, where it exists, also refuses a link made since the check.
        flags = os.O_WRONLY | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)
        return os.open(path, flags | getattr(os, "O_BINARY", 0), 0o666)
    except OSError as error:
        raise FluxobsError(f"{path}: cannot be written: {error.strerror}") from None
