"""Results of a benchmark as data: docs/numbers/NAME.json, from which the docs take their numbers.

    with Numbers("measured") as numbers:
        numbers.value("mean", 0.95, "{:.2f}°")
        numbers.table("logs", ["log", "rms"], rows)

The file is written only if the command has the option --write, and only at the end of the block.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterable, Sequence
from datetime import date
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
NUMBERS = ROOT / "docs" / "numbers"
#: A result whose command takes less than this time of a processor is quick [s].
QUICK = 20.0
#: C sources of the observers, of the smoother and of their binding.
C_SOURCES = ("firmware/*.[ch]", "smoothing/*.[ch]", "binding/*.*")


class Numbers:
    """What one command prints, as values and tables with their keys.

    Parameters
    ----------
    name : str
        Name of the file, and first part of the keys in the docs.
    more : sequence of str
        Patterns of further files that can move the numbers, relative to the repository: for
        example the modules that a subprocess loads.
    """

    def __init__(self, name: str, more: Sequence[str] = ()) -> None:
        self.name, self.more = name, more
        self.values: dict[str, Any] = {}
        self.tables: dict[str, Any] = {}

    def value(self, key: str, value: Any, form: str = "{}") -> None:
        """Keep a number, a text, or a sequence of numbers that `form` shows together."""
        plain = [_plain(v) for v in value] if isinstance(value, list | tuple) else _plain(value)
        self.values[key] = {"value": plain, "format": form}

    def table(self, key: str, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
        """Keep a table; its cells are shown as `str` gives them."""
        cells = [[minus(str(cell)) for cell in row] for row in rows]
        self.tables[key] = {"header": list(header), "rows": cells}

    def __enter__(self) -> Numbers:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None and "--write" in sys.argv:
            self.write()

    def write(self) -> None:
        """Write the file."""
        from common import machine_line

        script = Path(sys.argv[0]).resolve()
        files = sources(script, self.more)
        words = [relative(script), *(word for word in sys.argv[1:] if word != "--write")]
        taken = os.times()
        data = {
            "command": shlex.join(words),
            "revision": revision(files),
            "date": date.today().isoformat(),
            "computer": machine_line(),
            "quick": taken.user + taken.system + taken.children_user < QUICK,
            "sources": {relative(path): digest(path) for path in files},
            "values": self.values,
            "tables": self.tables,
        }
        NUMBERS.mkdir(exist_ok=True)
        target = NUMBERS / f"{self.name}.json"
        target.write_text(json.dumps(data, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        print(f"Written: {relative(target)}")


def _plain(value: Any) -> Any:
    """Return a NumPy number as a number of Python; floats have eight significant digits."""
    value = value.item() if hasattr(value, "item") else value
    return float(f"{value:.8g}") if isinstance(value, float) else value


def read(name: str) -> dict[str, Any]:
    """Return the data of a result."""
    data: dict[str, Any] = json.loads((NUMBERS / f"{name}.json").read_text(encoding="utf-8"))
    return data


def names() -> list[str]:
    """Return the names of all results."""
    return sorted(path.stem for path in NUMBERS.glob("*.json"))


def text(entry: dict[str, Any]) -> str:
    """Return a value as the docs show it."""
    value = entry["value"]
    return minus(entry["format"].format(*(value if isinstance(value, list) else [value])))


def minus(cell: str) -> str:
    """Return the text with a minus sign, not a hyphen, before a number that begins a text."""
    return re.sub(r"^-(?=\d)", "−", cell)


def sources(script: Path, more: Sequence[str] = ()) -> list[Path]:
    """Return the files whose change can move the numbers of a script that has just run.

    These are the script, the modules of fluxobs and of the script's own folder that it has loaded,
    and all C sources.
    """
    loaded = [getattr(module, "__file__", None) for module in list(sys.modules.values())]
    paths = {Path(name).resolve() for name in loaded if name}
    kept = {p for p in paths if p.is_relative_to(ROOT / "src") or p.parent == script.parent}
    kept |= {script} | {p for pattern in (*C_SOURCES, *more) for p in ROOT.glob(pattern)}
    own = {p for p in kept if p.is_file() and p.suffix != ".so" and p.stem != "numbers_data"}
    return sorted(own)


def relative(path: Path) -> str:
    """Return the path of a file relative to the repository."""
    return path.relative_to(ROOT).as_posix()


def digest(path: Path) -> str:
    """Return the first digits of the file's SHA-256; empty if the file does not exist."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:12] if path.is_file() else ""


def revision(files: Sequence[Path]) -> str:
    """Return the short hash of HEAD, with + if one of the files differs from it."""

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
        return done.stdout.strip()

    changed = git("status", "--porcelain", "--", *map(str, files))
    return git("rev-parse", "--short=8", "HEAD") + ("+" if changed else "")


def changed_sources(data: dict[str, Any]) -> list[str]:
    """Return the sources of a result that changed since it was made."""
    return [name for name, kept in data["sources"].items() if digest(ROOT / name) != kept]
