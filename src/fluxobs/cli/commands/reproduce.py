"""`fluxobs reproduce`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from .. import show
from ..options import ForceOption


def reproduce(
    out: Annotated[
        Path, typer.Option(help="Folder for figures and report; created if missing.")
    ] = (Path("fluxobs-paper")),
    quick: Annotated[
        bool,
        typer.Option(
            "--quick", help="Simulate only 30 s of one scenario; this needs a third of the time."
        ),
    ] = False,
    deep: Annotated[
        bool,
        typer.Option(
            "--deep",
            help="Add the long studies (about ten minutes): scenario S2, scalar gain, later "
            "observers, the model as printed, closed loop, smoother, levitation at rest.",
        ),
    ] = False,
    force: ForceOption = False,
) -> None:
    """Reproduce Section V of the paper.

    As printed, corrected, and extended. Writes report.html (and .md), numbers.json and figures
    (PNG, and SVG unless --quick).

    Needs the extra "design" (JAX).
    """
    # Compilation takes most of the time. JAX reads this variable on import.
    if not deep:
        os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0")
    from ...core.output import make_folder
    from ...research.paper.reproduce import reproduce as run

    make_folder(out, "report.md", force)
    run(out, quick, deep, typer.echo)
    show.say(f"Written: {out / 'report.html'}, report.md, numbers.json and figures")
