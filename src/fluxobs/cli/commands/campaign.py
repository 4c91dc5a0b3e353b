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

#: Exit code if a limit of the specification is missed or no scenario could be simulated.
MISSED = 1
#: Default number of scenarios in a search.
BUDGET = 1024


def campaign(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="SPEC.toml|FOLDER",
            help="Specification of a new campaign; or folder of an existing campaign, to resume or "
            "show the campaign or to rerun a scenario.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for the results; scenarios already there are not repeated."),
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = LOCAL,
    rerun: Annotated[
        int | None, typer.Option(min=0, help="Number of one scenario to simulate again.")
    ] = None,
    observer: Annotated[
        str | None,
        typer.Option(
            help="Observer for --rerun or --search; default: the campaign's first observer."
        ),
    ] = None,
    search: Annotated[
        str | None,
        typer.Option(
            metavar="worst|failures",
            help="worst: find the tolerances with the largest error of --observer (CMA-ES), "
            "starting from the worst scenario so far. failures: estimate the probability that "
            "a scenario is not good (importance sampling).",
        ),
    ] = None,
    machine: Annotated[
        str | None,
        typer.Option(help="Machine for --search; default: the campaign's first machine."),
    ] = None,
    budget: Annotated[
        int | None, typer.Option(min=64, help="Number of scenarios of the search; default 1024.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="Interactive report of the rerun to write, .html.")
    ] = None,
    record: Annotated[
        Path | None, typer.Option(help="Log of the rerun to write, .parquet.")
    ] = None,
    force: ForceOption = False,
) -> None:
    """Simulate thousands of drives within their tolerances.

    Reports the share of good estimates. Writes a dataset (one row per scenario and observer),
    report.html, and the worst scenarios with their records. The same command resumes a run that was
    stopped or killed. Exit code 1: a limit of the specification is missed, or no scenario could be
    simulated. Needs the extra "design" (JAX); Dask needs the extra "cluster".

    Example: fluxobs campaign product.toml --out product
    """
    run_options = {"--out": out, "--workers": workers, "--scheduler": _unless_local(scheduler)}
    rerun_options = {"--report": report, "--record": record, "--force": force or None}
    search_options = {"--machine": machine, "--budget": budget}
    if rerun is not None:
        refuse(
            {"--search": search} | run_options | search_options, "cannot be combined with --rerun"
        )
        _rerun(_open_repeatable(source, "--rerun"), rerun, observer, report, record, force)
    elif search is not None:
        refuse(run_options | rerun_options, "cannot be combined with --search")
        _search(_open_repeatable(source, "--search"), search, machine, observer, budget or BUDGET)
    else:
        refuse(rerun_options, "works only with --rerun NUMBER")
        refuse(search_options, "works only with --search")
        refuse({"--observer": observer}, "works only with --rerun NUMBER or --search")
        raise typer.Exit(_run(source, out, workers, scheduler))


def _unless_local(scheduler: str) -> str | None:
    """Return the scheduler, or None if it is the default."""
    return None if scheduler == LOCAL else scheduler


def _open_repeatable(folder: Path, option: str) -> Dataset:
    """Open the campaign in a folder; raise UsageError if its scenarios cannot be repeated."""
    from ...campaigns import open_dataset

    if not folder.is_dir():
        raise UsageError(f"{option}: give the folder of the campaign")
    dataset = open_dataset(folder)
    if dataset.changed:
        raise UsageError(f"{option}: {folder} cannot be repeated: {dataset.changed}")
    return dataset


def _run(source: Path, out: Path | None, workers: int | None, scheduler: str) -> int:
    """Simulate the missing scenarios, show the results, and return the exit code."""
    from ...campaigns import campaign as run
    from ...campaigns import open_dataset

    specification: Path | Specification = source
    if source.is_dir():
        if out is not None:
            raise UsageError(f"--out: {source} is already the folder of the results")
        existing = open_dataset(source)
        if existing.changed and not existing.lacking():
            show.say(
                f"Warning: the campaign's rows cannot be repeated: {existing.changed}.", err=True
            )
            return _show(existing)
        specification, out = existing.specification, source
    elif out is None:
        raise UsageError("--out is missing: give a folder for the results")
    with show.Progress("finished scenarios are kept; run the same command to resume") as progress:
        dataset = run(specification, out, workers=workers, scheduler=scheduler, progress=progress)
    return _show(dataset)


def _show(dataset: Dataset) -> int:
    """Print and write the report; return the exit code."""
    from ...campaigns import report, statistics

    results = dataset.rows()
    table, sentences = report.text(dataset, results)
    show.echo(report.headline(dataset))
    show.table(table)
    for sentence in sentences:
        show.echo(sentence)
    if results["failed"].null_count() == 0:
        show.echo("No scenario could be simulated.")
    verdicts = statistics.verdicts(dataset.specification, results)
    for verdict in verdicts:
        show.echo(f"Limit {verdict}.")
    show.say(f"Written: {report.write_html(dataset, results)}")
    passed = all(verdict.met for verdict in verdicts) and results["failed"].null_count() > 0
    return 0 if passed else MISSED


def _rerun(
    dataset: Dataset,
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

        check_estimated(dataset.specification.observer(observer))
        check_new(report, (".html",), force, "--report")
        built("report.html")
    if record is not None:
        check_new(record, (".parquet",), force, "--record")
    scenario = rerun(dataset.specification, [number], observer)[0]
    width = max(len(name) for name in scenario.row)
    for name, value in scenario.row.items():
        if value is not None:
            show.say(
                f"{name:{width}}  {value:.6g}"
                if isinstance(value, float)
                else f"{name:{width}}  {value}"
            )
    if record is not None:
        check_new(record, (".parquet",), force, "--record")  # again: the file may exist by now
        write_record(scenario, record)
        show.say(f"Written: {record}")
    if report is not None:
        result = scenario.estimate()
        show.echo(result.summary)
        check_new(report, (".html",), force, "--report")
        result.write(report)
        show.say(f"Written: {report}")


def _search(
    dataset: Dataset, search: str, machine: str | None, observer: str | None, budget: int
) -> None:
    from ...campaigns.report import degrees
    from ...campaigns.search import estimate_rare, find_worst
    from ...campaigns.statistics import in_words

    if search not in ("worst", "failures"):
        raise UsageError(f"--search {search}: choose worst or failures")
    specification = dataset.specification
    machine, observer = (
        machine or specification.machines[0],
        observer or specification.observers[0].name,
    )
    with show.Progress("nothing was written") as progress:
        if search == "failures":
            rare = estimate_rare(specification, machine, observer, budget=budget, progress=progress)
            show.echo(
                f"Probability that a scenario of {observer} on {machine} is not good "
                f"({in_words(specification.good)}): {rare}."
            )
            return
        worst = find_worst(
            specification, machine, observer, dataset.rows(), budget=budget, progress=progress
        )
    row = worst.row
    show.echo(
        f"Largest error of {observer} on {machine} in {worst.tried} scenarios: "
        f"{degrees(row['worst'])} on a valid row, {degrees(row['rms'])} rms, with course and "
        f"noise of scenario {worst.like}:"
    )
    width = max(len(name) for name in worst.values)
    for name, value in worst.values.items():
        show.say(f"  {name:{width}}  {value:.6g}")
