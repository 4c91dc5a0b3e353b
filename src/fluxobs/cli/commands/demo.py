"""`fluxobs demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .. import show
from .estimate import show_result


def demo(
    out: Annotated[Path, typer.Option(help="Folder for the results; created if missing.")] = Path(
        "fluxobs-demo"
    ),
) -> None:
    """Run `fluxobs estimate` on the log of a servo motor."""
    from ... import estimate as run
    from ...core.output import make_folder
    from ...simulation.closed_form.demo import MACHINE, demo_log

    make_folder(out)
    estimates = out / "estimates.parquet"
    with show.Progress() as progress:
        result = run(demo_log(), MACHINE, out=estimates, force=True, progress=progress)
    result.write(out / "report.png")
    show_result(result, MACHINE, [estimates, out / "report.png"])
