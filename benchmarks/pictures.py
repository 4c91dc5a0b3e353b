"""Pictures of the docs, from the commands that draw them.

python benchmarks/pictures.py              # the demo's: docs/images/demo.png
python benchmarks/pictures.py demo paper   # and those of `fluxobs reproduce`, in two minutes

The picture of the scores is made by score_page.py, that of a campaign by product.py.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
#: Arguments of a command, and its pictures with their names in the docs.
SOURCES = {
    "demo": (("demo",), {"report.png": "demo.png"}),
    "paper": (
        ("reproduce",),
        {name: name for name in ("figure_3.png", "adaptive_flux.png", "counter_example.png")},
    ),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", choices=[[], *SOURCES], metavar="demo|paper")
    for name in parser.parse_args().names or ["demo"]:
        arguments, pictures = SOURCES[name]
        with tempfile.TemporaryDirectory() as scratch:
            out = Path(scratch) / "out"
            subprocess.run(
                [sys.executable, "-m", "fluxobs", *arguments, "--out", str(out)],
                check=True,
                stdout=subprocess.DEVNULL,
            )
            for drawn, shown in pictures.items():
                shutil.copyfile(out / drawn, IMAGES / shown)
                print(f"docs/images/{shown}: fluxobs {' '.join(arguments)}")


if __name__ == "__main__":
    main()
