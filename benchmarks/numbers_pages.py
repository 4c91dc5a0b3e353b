"""Numbers in README.md and docs/: marked places in Markdown, filled from docs/numbers/.

In a sentence: ``<!--= measured.mean -->0.95°<!--/-->``. A table stands between two lines,
``<!-- numbers: measured.logs -->`` and ``<!-- end -->``; with several keys, separated by commas,
it has the rows of all of them. The line below the table names command, revision and date.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from numbers_data import ROOT, read, relative, text

VALUE = re.compile(r"<!--= *([\w.-]+) *-->(.*?)<!--/-->")
TABLE = re.compile(r"<!-- numbers: *([\w., -]+?) *-->\n(.*?)<!-- end -->", re.DOTALL)
#: A comment that begins a line would end the paragraph.
AT_LINE_START = re.compile(r"^[ \t>*+-]*<!--=", re.MULTILINE)


class UnknownKeyError(Exception):
    """A page names a key without data."""


@dataclass(frozen=True)
class Difference:
    """A marked place whose text is not that of its data."""

    page: Path
    key: str
    shown: str
    made: str

    def __str__(self) -> str:
        return f"{relative(self.page)}: {self.key}: page {self.shown!r}, data {self.made!r}"


@dataclass
class Filled:
    """A page with its numbers as the data give them."""

    text: str
    differences: list[Difference] = field(default_factory=list)
    keys: list[str] = field(default_factory=list)


def pages() -> list[Path]:
    """Return the pages that may hold numbers."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


@cache
def _data(name: str) -> dict[str, Any]:
    return read(name)


def entry(key: str, part: str) -> Any:
    """Return the entry of a key, NAME.KEY, in `part`: values or tables."""
    name, _, own = key.partition(".")
    try:
        return _data(name)[part][own]
    except (FileNotFoundError, KeyError):
        raise UnknownKeyError(
            f"{key}: docs/numbers/{name}.json has no such key in {part}"
        ) from None


def table(keys: list[str]) -> str:
    """Return tables of equal headers as one, and the line on their origin."""
    tables = [entry(key, "tables") for key in keys]
    header = tables[0]["header"]
    if any(one["header"] != header for one in tables):
        raise UnknownKeyError(f"{', '.join(keys)}: the headers differ")
    rows = [header, ["---"] * len(header), *(row for one in tables for row in one["rows"])]
    lines = [f"| {' | '.join(row)} |" for row in rows]
    lines[1] = "|" + "---|" * len(header)
    lines = [re.sub(r"(?<=\|) +(?=\|)", " ", line) for line in lines]
    origins = dict.fromkeys(map(origin, keys))
    return "\n".join([*lines, "", f"*{'; '.join(origins)}*", ""])


def origin(key: str) -> str:
    """Return command, revision and date of a table; a copied table may have its own revision."""
    data = _data(key.partition(".")[0]) | entry(key, "tables")
    return f"{data['command']}, revision {data['revision']}, {data['date']}"


def filled(page: Path, content: str) -> Filled:
    """Return the page with every marked place filled from its data."""
    result = Filled("")
    if misplaced := AT_LINE_START.search(content):
        line = content[: misplaced.start()].count("\n") + 1
        raise UnknownKeyError(f"{relative(page)}:{line}: a number may not begin a line")

    def replace(made: Callable[[str], str], form: str) -> Callable[[re.Match[str]], str]:
        def place(match: re.Match[str]) -> str:
            key, shown, now = match[1], match[2], made(match[1])
            result.keys.extend(re.split(r"\s*,\s*", key))
            if shown != now:
                result.differences.append(Difference(page, key, *_unequal(shown, now)))
            return form.format(key, now)

        return place

    def value(key: str) -> str:
        return text(entry(key, "values"))

    def block(keys: str) -> str:
        return table(re.split(r"\s*,\s*", keys))

    content = TABLE.sub(replace(block, "<!-- numbers: {} -->\n{}<!-- end -->"), content)
    result.text = VALUE.sub(replace(value, "<!--= {} -->{}<!--/-->"), content)
    return result


def _unequal(shown: str, made: str) -> tuple[str, str]:
    """Return the first lines that differ."""
    before, after = shown.split("\n"), made.split("\n")
    length = max(len(before), len(after))
    before, after = (lines + [""] * (length - len(lines)) for lines in (before, after))
    return next(pair for pair in zip(before, after, strict=True) if pair[0] != pair[1])
