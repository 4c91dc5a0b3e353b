"""Records that are shipped, for the logs of known tools: a TOML each in presets/."""

from __future__ import annotations

import tomllib
from importlib import resources
from typing import Any

from ..core.validation import nearest
from ..errors import RecordError
from .layout import fields_from


def _folder() -> Any:
    return resources.files(__package__) / "presets"


def preset_names() -> list[str]:
    """Names of the shipped presets."""
    return sorted(entry.name[:-5] for entry in _folder().iterdir() if entry.name.endswith(".toml"))


def preset_text(name: str) -> str:
    """TOML of a preset, with its comments: what it is for, and where its facts are from.

    Raises
    ------
    RecordError
        There is none of that name.
    """
    if name not in preset_names():
        raise RecordError(f"no preset {name!r}{nearest(name, preset_names())}")
    return str((_folder() / f"{name}.toml").read_text(encoding="utf-8"))


def preset_fields(name: str) -> dict[str, Any]:
    """Fields of a preset, as of a record TOML.

    Raises
    ------
    RecordError
        There is none of that name, or the logs of that tool cannot be used; the message says why.
    """
    text = preset_text(name)
    refused = tomllib.loads(text).get("refused")
    if refused is not None:
        raise RecordError(f"preset {name}: {refused}")
    return fields_from(text, f"preset {name}")
