"""Tables that commands here write into docs/firmware.md, between two comments with their name."""

from __future__ import annotations

from pathlib import Path

PAGE = Path(__file__).resolve().parents[3] / "docs" / "firmware.md"


def _parts(name: str) -> tuple[str, str, str]:
    text = PAGE.read_text(encoding="utf-8")
    before, start, rest = text.partition(f"<!-- {name} -->\n")
    now, end, after = rest.partition(f"\n<!-- /{name} -->")
    if not (start and end):
        raise SystemExit(f"{PAGE}: no place for {name}")
    return before + start, now, end + after


def read(name: str) -> str:
    """The table as it stands in the page."""
    return _parts(name)[1]


def write(name: str, table: str) -> None:
    """Put a table in the place of the one that stands there."""
    before, _, after = _parts(name)
    PAGE.write_text(before + table + after, encoding="utf-8")
