"""Files that other files name."""

from __future__ import annotations

from pathlib import Path

from ..errors import FluxobsError


def beside(folder: Path, name: str, field: str) -> Path:
    """The path of a file that another file names: in its folder, or below.

    Files come from others: what they name is not to be read from the rest of the computer.

    Raises
    ------
    FluxobsError
        It lies elsewhere, by its path or by a link.
    """
    path = folder / name
    try:
        inside = path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError):  # a circle of links, a character that no path has
        raise FluxobsError(f"{field}: {name!r} is no path of a file") from None
    if not inside:
        raise FluxobsError(
            f"{field}: {name!r} lies outside of the folder {str(folder)!r}, from which alone files "
            f"are taken; copy it there"
        )
    return path
