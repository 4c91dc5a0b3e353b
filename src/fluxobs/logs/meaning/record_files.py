"""Record files: the layout of a log in TOML, for reading this log or similar logs again."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...core.output import check_new, write_text
from ...machines.file_text import comment
from ..log import Log
from .layout import NO_COLUMN

_MAPPINGS = ("columns", "unit", "adc", "scale", "offset", "truth")


def record_text(log: Log) -> str:
    """Return the text of a record TOML with all given and guessed fields."""
    layout = log.layout
    fields = layout.model_dump(
        exclude_defaults=True, exclude={*_MAPPINGS, "join", "note", "priors"}
    )
    fields["frame"] = log.frame
    if layout.lag_stated:
        fields["lag"] = layout.lag
    lines = [
        f"# How {comment(log.path.name)} is read: `fluxobs estimate LOG --record THIS.toml`",
        *(f"# {comment(note)}" for note in log.notes),
        *(f"{name} = {_value(value)}" for name, value in sorted(fields.items())),
    ]
    columns = dict(log.names)
    if "t" not in columns and layout.columns.get("t") == NO_COLUMN:
        columns["t"] = NO_COLUMN
    used = {"t", *columns, "udc", *([] if log.true is None else [log.true.channel])}
    tables: dict[str, Mapping[str, Any]] = {
        "columns": columns,
        "truth": {} if log.true is None else dict([log.truth or ("", "")]),
    }
    tables["priors"] = layout.priors
    for name in ("unit", "adc", "scale", "offset"):
        entries = getattr(layout, name)
        tables[name] = {key: entries[key] for key in entries if key in used or len(key) < 6}
    for name, table in tables.items():
        if table:
            items = ", ".join(f"{key} = {_value(value)}" for key, value in table.items())
            lines.append(f"{name} = {{ {items} }}")
    return "\n".join(lines) + "\n"


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    # TOML forbids a bare DEL
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def write_record(log: Log, path: str | Path, *, force: bool = False) -> None:
    """Write a record file.

    Raises
    ------
    FluxobsError
        The path does not end in .toml, exists without `force`, or cannot be written.
    """
    path = Path(path)
    check_new(path, (".toml",), force, "--save-record")
    write_text(path, record_text(log))
