"""Presets: shipped record files for the logs of known tools; each is a TOML file in presets/."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from importlib import resources
from typing import Any

from ...core.validation import nearest
from ...errors import RecordError
from .layout import fields_from


def _folder() -> Any:
    return resources.files(__package__) / "presets"


def preset_names() -> list[str]:
    """Return the names of the shipped presets."""
    return sorted(entry.name[:-5] for entry in _folder().iterdir() if entry.name.endswith(".toml"))


def preset_text(name: str) -> str:
    """Return the TOML of a preset, with comments on its purpose and sources.

    Raises
    ------
    RecordError
        No preset has this name.
    """
    if name not in preset_names():
        raise RecordError(f"no preset {name!r}{nearest(name, preset_names())}")
    return str((_folder() / f"{name}.toml").read_text(encoding="utf-8"))


def refusal_of(columns: Iterable[str]) -> str:
    """Return why logs with these columns cannot be used; empty if no preset knows a reason."""
    given = set(columns)
    for name in preset_names():
        content = tomllib.loads(preset_text(name))
        if "refused" in content and set(content.get("known_by", ["?"])) <= given:
            return f"this is a log of preset {name}: {content['refused']}"
    return ""


def preset_fields(name: str) -> dict[str, Any]:
    """Return the fields of a preset, as in a record TOML.

    Raises
    ------
    RecordError
        No preset has this name, or logs of the tool cannot be used; the message says why.
    """
    text = preset_text(name)
    refusal = tomllib.loads(text).get("refused")
    if refusal is not None:
        raise RecordError(f"preset {name}: {refusal}")
    return fields_from(text, f"preset {name}")
