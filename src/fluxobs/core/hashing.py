"""Hashes of file contents."""

from __future__ import annotations

import hashlib
from pathlib import Path

from ..errors import FluxobsError
from .input_files import check_regular

#: Bytes per read.
BLOCK = 1 << 20


def hash_file(path: Path) -> str:
    """Return the SHA-256 hash of a file.

    Raises
    ------
    FluxobsError
        The file cannot be read.
    """
    check_regular(path, FluxobsError)
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while block := file.read(BLOCK):
                digest.update(block)
    except FileNotFoundError:
        raise FluxobsError(f"{path}: no such file") from None
    except OSError as error:
        raise FluxobsError(f"{path}: cannot be read: {error.strerror}") from None
    return digest.hexdigest()
