"""`fluxobs compare`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from .. import show
from ..options import ForceOption, reads_logs


@reads_logs()
def compare(
    records: Annotated[
        list[str],
        typer.Argument(
            metavar="LOG|SCENARIO …",
            help="Logs with a true angle (--truth), or scenarios by name; `list` lists them, "
            "`all` takes all.",
        ),
    ],
    layout: dict[str, Any],
    machine: Annotated[
        Path | None,
        typer.Option(
            help="TOML or a name from `fluxobs machines`. Scenarios run on the shipped machines "
            "that turn; default pmsm-2kw2."
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for scores and pictures; made if missing.")] = (
        Path("fluxobs-compare")
    ),
    seed: Annotated[int, typer.Option(min=0, help="Seed of a scenario's sensor noise.")] = 0,
    settle: Annotated[
        float, typer.Option(help="Seconds of a log that are not scored, while observers settle.")
    ] = 0.2,
    force: ForceOption = False,
) -> None:
    """Run a log or a scenario through every known observer, and score them.

    Each observer runs with usual gains, and with the best of a grid for this very record.

    Writes scores.csv, report.html, one picture per record, and summary.png for several records.
    Needs the extra "design" (JAX).

    Example: fluxobs compare noise both-biases R-120
    """
    from ...comparison.scenarios import SCENARIOS

    if "list" in records:
        width = max(len(name) for name in SCENARIOS)
        for scenario in SCENARIOS.values():
            show.say(f"{scenario.name:{width}}  {scenario.about}")
        return
    from ...comparison import report
    from ...comparison.compare import check_comparable
    from ...comparison.compare import compare as run
    from ...core.output import make_folder

    names = [n for r in records for n in (SCENARIOS if r == "all" else [r])]
    for name in names:
        check_comparable(name, machine)
    make_folder(out, "scores.csv", force)
    comparisons, drawn = [], []
    for name in names:
        options = {} if name in SCENARIOS else layout
        found = run(name, machine, seed=seed, settle=settle, **options)
        comparisons.append(found)
        show.table(report.table(found))
        show.echo(report.verdict(found))
        drawn.append(out / f"{Path(found.title).stem}.png")
        report.draw(found, drawn[-1])
        report.write_csv(comparisons, out / "scores.csv")
    if len(comparisons) > 1:
        drawn.append(out / "summary.png")
        report.draw_summary(comparisons, drawn[-1])
    report.write_html(comparisons, drawn, out / "report.html")
    pictures = "one picture per record" + (", summary.png" if len(comparisons) > 1 else "")
    show.say(f"Written: {out / 'scores.csv'}, report.html, {pictures}")
