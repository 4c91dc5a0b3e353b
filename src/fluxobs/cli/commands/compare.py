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
            help="Logs with a true angle (--truth), or names of scenarios; `list` lists the "
            "scenarios, `all` runs all scenarios.",
        ),
    ],
    layout: dict[str, Any],
    machine: Annotated[
        Path | None,
        typer.Option(
            help="Machine file, or a name from `fluxobs machines`. Scenarios run only on shipped "
            "rotating machines; default pmsm-2kw2."
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option(help="Folder for scores and pictures; created if missing.")
    ] = (Path("fluxobs-compare")),
    seed: Annotated[int, typer.Option(min=0, help="Seed of a scenario's sensor noise.")] = 0,
    settle: Annotated[
        float,
        typer.Option(
            help="Seconds at the start of a log, in which observers settle and are not scored."
        ),
    ] = 0.2,
    force: ForceOption = False,
) -> None:
    """Score all built-in observers on a log or scenario.

    Each observer runs with recommended gains, and with the best gains of a grid for this record.

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

    names = [name for record in records for name in (SCENARIOS if record == "all" else [record])]
    for name in names:
        check_comparable(name, machine)
    make_folder(out, "scores.csv", force)
    comparisons, pictures = [], []
    for name in names:
        options = {} if name in SCENARIOS else layout
        comparison = run(name, machine, seed=seed, settle=settle, **options)
        comparisons.append(comparison)
        show.table(report.table(comparison))
        show.echo(report.verdict(comparison))
        pictures.append(out / f"{Path(comparison.title).stem}.png")
        report.draw(comparison, pictures[-1])
        report.write_csv(comparisons, out / "scores.csv")
    if len(comparisons) > 1:
        pictures.append(out / "summary.png")
        report.draw_summary(comparisons, pictures[-1])
    report.write_html(comparisons, pictures, out / "report.html")
    picture_names = "one picture per record" + (", summary.png" if len(comparisons) > 1 else "")
    show.say(f"Written: {out / 'scores.csv'}, report.html, {picture_names}")
