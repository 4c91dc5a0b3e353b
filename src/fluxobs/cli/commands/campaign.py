"""`fluxobs campaign`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...core.engine import LOCAL
from ...errors import UsageError
from .. import show
from ..many_logs import refuse
from ..options import ForceOption, SchedulerOption, WorkersOption

if TYPE_CHECKING:
    from ...campaigns import Dataset, Specification

#: Exit code if a limit of the specification is missed, or nothing could be simulated.
MISSED = 1
#: Scenarios of a search.
BUDGET = 1024


def campaign(
    what: Annotated[
        Path,
        typer.Argument(
            metavar="SPEC.toml|FOLDER",
            help="A specification; or the folder of a campaign, to go on with it, show it, or "
            "rerun a scenario of it.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of the results; what is there already is not done again."),
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = LOCAL,
    rerun: Annotated[
        int | None, typer.Option(min=0, help="Number of a scenario to simulate again, alone.")
    ] = None,
    observer: Annotated[
        str | None, typer.Option(help="Observer of rerun or search; default the first.")
    ] = None,
    search: Annotated[
        str | None,
        typer.Option(
            metavar="worst|failures",
            help="worst: look for the tolerances that break --observer (CMA-ES), from the worst "
            "scenario so far. failures: how rare a scenario is that is not good (importance "
            "sampling).",
        ),
    ] = None,
    machine: Annotated[
        str | None, typer.Option(help="Machine of the search; default the first.")
    ] = None,
    budget: Annotated[
        int | None, typer.Option(min=64, help="Scenarios of the search; default 1024.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="Interactive report of the rerun, .html.")
    ] = None,
    record: Annotated[
        Path | None, typer.Option(help="Record of the rerun, .parquet, as a log.")
    ] = None,
    force: ForceOption = False,
) -> None:
    """Simulate thousands of drives within their tolerances, and say how many an observer is good
    for.

    Writes a dataset (a row per scenario and observer), report.html, and the worst scenarios with
    their records. A run that was stopped or killed goes on where it was. Exit code 1: a limit of
    the specification is missed, or no scenario could be simulated. Needs the extra "design" (JAX);
    "cluster" for Dask.

    Example: fluxobs campaign product.toml --out product
    """
    run = {"--out": out, "--workers": workers, "--scheduler": _unusual(scheduler)}
    again = {"--report": report, "--record": record, "--force": force or None}
    search_only = {"--machine": machine, "--budget": budget}
    if rerun is not None:
        refuse({"--search": search} | run | search_only, "other than --rerun")
        _again(_repeatable(what, "--rerun"), rerun, observer, report, record, force)
    elif search is not None:
        refuse(run | again, "other than --search")
        _search(_repeatable(what, "--search"), search, machine, observer, budget or BUDGET)
    else:
        refuse(again, "--rerun NUMBER")
        refuse(search_only, "--search")
        refuse({"--observer": observer}, "--rerun NUMBER or --search")
        raise typer.Exit(_run(what, out, workers, scheduler))


def _unusual(scheduler: str) -> str | None:
    """A scheduler, or None if it is the default."""
    return None if scheduler == LOCAL else scheduler


def _repeatable(folder: Path, option: str) -> Dataset:
    """The campaign in a folder, if scenarios of it can be simulated again."""
    from ...campaigns import open_dataset

    if not folder.is_dir():
        raise UsageError(f"{option}: give the folder of the campaign")
    found = open_dataset(folder)
    if found.changed:
        raise UsageError(f"{option}: {folder} cannot be repeated: {found.changed}")
    return found


def _run(what: Path, out: Path | None, workers: int | None, scheduler: str) -> int:
    """Do what is missing and show all; returns the exit code."""
    from ...campaigns import campaign as run
    from ...campaigns import open_dataset

    specification: Path | Specification = what
    if what.is_dir():
        if out is not None:
            raise UsageError(f"--out: {what} is the folder of the results already")
        there = open_dataset(what)
        if there.changed and not there.lacking():
            show.say(f"Warning: its rows cannot be repeated: {there.changed}.", err=True)
            return _show(there)
        specification, out = there.specification, what
    elif out is None:
        raise UsageError("--out FOLDER is missing: where the results go")
    with show.Progress("what is done is kept, the same command goes on") as progress:
        found = run(specification, out, workers=workers, scheduler=scheduler, progress=progress)
    return _show(found)


def _show(found: Dataset) -> int:
    """Print and write the report; returns the exit code."""
    from ...campaigns import report, statistics

    rows = found.rows()
    table, sentences = report.text(found, rows)
    show.echo(report.headline(found))
    show.table(table)
    for sentence in sentences:
        show.echo(sentence)
    if rows["failed"].null_count() == 0:
        show.echo("No scenario could be simulated.")
    verdicts = statistics.verdicts(found.specification, rows)
    for verdict in verdicts:
        show.echo(f"Limit {verdict}.")
    show.say(f"Written: {report.write_html(found, rows)}")
    met = all(verdict.met for verdict in verdicts) and rows["failed"].null_count() > 0
    return 0 if met else MISSED


def _again(
    found: Dataset,
    number: int,
    observer: str | None,
    report: Path | None,
    record: Path | None,
    force: bool,
) -> None:
    from ...campaigns.rerun import check_estimated, rerun, write_record
    from ...core.output import check_new

    if report is not None:
        from ...page import built

        check_estimated(found.specification.observer(observer))
        check_new(report, (".html",), force, "--report")
        built("report.html")
    if record is not None:
        check_new(record, (".parquet",), force, "--record")
    one = rerun(found.specification, [number], observer)[0]
    width = max(len(name) for name in one.row)
    for name, value in one.row.items():
        if value is not None:
            show.say(
                f"{name:{width}}  {value:.6g}"
                if isinstance(value, float)
                else f"{name:{width}}  {value}"
            )
    if record is not None:
        check_new(record, (".parquet",), force, "--record")  # once more: the run took a while
        write_record(one, record)
        show.say(f"Written: {record}")
    if report is not None:
        result = one.estimate()
        show.echo(result.summary)
        check_new(report, (".html",), force, "--report")
        result.write(report)
        show.say(f"Written: {report}")


def _search(
    found: Dataset, search: str, machine: str | None, observer: str | None, budget: int
) -> None:
    from ...campaigns.report import degrees
    from ...campaigns.search import estimate_rare, find_worst
    from ...campaigns.statistics import in_words

    if search not in ("worst", "failures"):
        raise UsageError(f"--search {search}: worst or failures")
    s = found.specification
    machine, observer = machine or s.machines[0], observer or s.observers[0].name
    with show.Progress("nothing was written") as progress:
        if search == "failures":
            rare = estimate_rare(s, machine, observer, budget=budget, progress=progress)
            show.echo(
                f"Probability that a scenario of {observer} on {machine} is not good "
                f"({in_words(s.good)}): {rare}."
            )
            return
        worst = find_worst(s, machine, observer, found.rows(), budget=budget, progress=progress)
    row = worst.row
    show.echo(
        f"Worst of {worst.tried} scenarios of {observer} on {machine}: {degrees(row['worst'])} on "
        f"a valid row, {degrees(row['rms'])} rms, with course and noise of scenario {worst.like}:"
    )
    width = max(len(name) for name in worst.values)
    for name, value in worst.values.items():
        show.say(f"  {name:{width}}  {value:.6g}")
