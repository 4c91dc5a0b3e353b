"""Paths of files that other files name."""

from __future__ import annotations

from pathlib import Path

from ..errors import FluxobsError


def beside(folder: Path, name: str, field: str) -> Path:
    """Return the path of a file named in a file of `folder`, which must be in or below `folder`.

    A received file must not make the program read the rest of the computer.

    Raises
    ------
    FluxobsError
        The path, or a link, leads out of the folder.
    """
    path = folder / name
    try:
        inside = path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError):  # circular links or an invalid character
        raise FluxobsError(f"{field}: {name!r} is not a valid path") from None
    if not inside:
        raise FluxobsError(
            f"{field}: {name!r} is outside the folder {str(folder)!r}, where all named files "
            f"must be; copy the file there"
        )
    return path
