"""Hashes that stand for the content of files."""

from __future__ import annotations

import hashlib
from pathlib import Path

from ..errors import FluxobsError
from .input_files import check_regular

#: Bytes read at once.
BLOCK = 1 << 20


def content_of(place: Path) -> str:
    """Hash of a file.

    Raises
    ------
    FluxobsError
        It cannot be read.
    """
    check_regular(place, FluxobsError)
    digest = hashlib.sha256()
    try:
        with place.open("rb") as file:
            while block := file.read(BLOCK):
                digest.update(block)
    except FileNotFoundError:
        raise FluxobsError(f"{place}: no such file") from None
    except OSError as error:
        raise FluxobsError(f"{place}: cannot be read: {error.strerror}") from None
    return digest.hexdigest()
