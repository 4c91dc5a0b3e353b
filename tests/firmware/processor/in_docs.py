"""Results of these scripts as data, from which the docs take their numbers."""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
sys.path.append(str(ROOT / "benchmarks"))

from numbers_data import Numbers, read  # noqa: E402

__all__ = ["SOURCES", "Numbers", "add_table", "read"]

#: What moves the numbers, besides the modules of fluxobs and the C sources.
SOURCES = ("tests/firmware/processor/*.*", "src/fluxobs/deployment/templates/c/*")


def add_table(numbers: Numbers, key: str, markdown: str) -> None:
    """Keep a table that is printed as Markdown; lines below it are ignored."""
    lines = [line for line in markdown.split("\n") if line.startswith("|")]
    header, _, *rows = ([cell.strip() for cell in re.split(r"\|", line)[1:-1]] for line in lines)
    numbers.table(key, header, rows)
