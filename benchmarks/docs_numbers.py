"""The numbers of the docs: made from docs/numbers/, not typed.

python benchmarks/docs_numbers.py render         # writes README.md and docs/ from the data
python benchmarks/docs_numbers.py check          # exit code 1 if a page differs from its data
python benchmarks/docs_numbers.py stale          # lists results whose sources changed
python benchmarks/docs_numbers.py run [--quick]  # runs the commands of these results
"""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

from numbers_data import ROOT, changed_sources, names, read, relative
from numbers_pages import Difference, filled, pages


def render() -> int:
    """Write the numbers into the pages."""
    for page in pages():
        content = page.read_text(encoding="utf-8")
        made = filled(page, content).text
        if made != content:
            page.write_text(made, encoding="utf-8")
            print(f"Written: {relative(page)}")
    return 0


def differences() -> list[Difference]:
    """Return every marked place whose text is not that of its data."""
    return [
        difference
        for page in pages()
        for difference in filled(page, page.read_text(encoding="utf-8")).differences
    ]


def check() -> int:
    """Print what differs; `render` writes the pages again."""
    wrong = differences()
    print("\n".join(map(str, wrong)) or "The pages show the numbers of their data.")
    return 1 if wrong else 0


def outdated() -> Iterator[tuple[str, dict[str, Any], list[str]]]:
    """Yield name, data and changed sources of each result whose sources changed."""
    for name in names():
        data = read(name)
        if changed := changed_sources(data):
            yield name, data, changed


def stale() -> int:
    """List the results whose sources changed since they were made."""
    for name, data, changed in outdated():
        more = f" and {len(changed) - 2} more" if len(changed) > 2 else ""
        print(f"{name} ({data['date']}): {', '.join(changed[:2])}{more} changed")
        python = "python " if shlex.split(data["command"])[0].endswith(".py") else ""
        print(f"    {python}{data['command']}{'' if data.get('copied') else ' --write'}")
    return 0


def run(only_quick: bool) -> int:
    """Run the commands of the results that `stale` lists, except those that write no data."""
    copied = 0
    for _, data, _ in list(outdated()):
        if data.get("copied"):
            copied += 1
        elif data["quick"] or not only_quick:
            command = [sys.executable, *shlex.split(data["command"]), "--write"]
            print(f"python {data['command']} --write", flush=True)
            subprocess.run(command, cwd=ROOT, check=True)
    if copied:
        print(f"{copied} outdated results were copied from pages: their commands write no data")
    return 0


def main() -> int:
    parser = argparse.ArgumentParser(description="The numbers of the docs.")
    parser.add_argument("action", choices=("render", "check", "stale", "run"))
    parser.add_argument("--quick", action="store_true", help="run only what takes a few seconds")
    options = parser.parse_args()
    if options.action == "run":
        return run(options.quick)
    return {"render": render, "check": check, "stale": stale}[options.action]()


if __name__ == "__main__":
    sys.exit(main())
