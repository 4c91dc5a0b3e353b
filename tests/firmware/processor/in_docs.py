"""Read and write the tables in docs/firmware.md, between two comments with their name."""

from __future__ import annotations

from pathlib import Path

PAGE = Path(__file__).resolve().parents[3] / "docs" / "firmware.md"


def _parts(name: str) -> tuple[str, str, str]:
    text = PAGE.read_text(encoding="utf-8")
    before, start, rest = text.partition(f"<!-- {name} -->\n")
    now, end, after = rest.partition(f"\n<!-- /{name} -->")
    if not (start and end):
        raise SystemExit(f"{PAGE}: the comments of the table {name} are missing")
    return before + start, now, end + after


def read(name: str) -> str:
    """Return the table in the page."""
    return _parts(name)[1]


def write(name: str, table: str) -> None:
    """Replace the table in the page."""
    before, _, after = _parts(name)
    PAGE.write_text(before + table + after, encoding="utf-8")
