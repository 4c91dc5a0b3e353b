"""Optional libraries that some formats need; each library is an extra of the package."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from ...errors import RecordError


def library(module: str, extra: str, path: Path) -> Any:
    """Import a library.

    Raises
    ------
    RecordError
        The library is not installed; the message names the extra.
    """
    try:
        return import_module(module)
    except ImportError:
        raise RecordError(
            f"{path}: reading {path.suffix} files needs {module.split('.')[0]}: pip install "
            f'"fluxobs[{extra}]"'
        ) from None
