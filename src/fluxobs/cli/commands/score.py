"""`fluxobs score`."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from ...errors import UsageError
from .. import show
from ..options import ForceOption, JsonOption, QuietOption

if TYPE_CHECKING:
    from ...benchmark import Suite


class Track(StrEnum):
    """Tracks of the benchmark."""

    offline = "offline"
    causal = "causal"
    closed_loop = "closed-loop"


#: Tracks of a folder of estimates.
STATED: dict[Track | None, Literal["offline", "causal"]] = {
    Track.offline: "offline",
    Track.causal: "causal",
}


def score(
    entrants: Annotated[
        list[str],
        typer.Argument(
            metavar="ENTRANT…",
            help="plain, adaptive, whole-log; the name of a published observer, or `published` for "
            "all; FILE.py:NAME or module:NAME; a shared library; a folder of estimates "
            "(docs/tasks/score.md).",
        ),
    ],
    suite: Annotated[
        Path,
        typer.Option(help="Folder of the suite. A missing suite is simulated first."),
    ],
    seed: Annotated[
        int | None,
        typer.Option(
            min=0, help="Seed of a new suite; default 1, the public one. A judge takes another."
        ),
    ] = None,
    drives: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Drives of each machine, course and kind of errors, of a new suite or of the "
            "closed loop; default 1.",
        ),
    ] = None,
    track: Annotated[
        Track | None,
        typer.Option(
            help="offline or causal: track of a folder of estimates. closed-loop: the observers "
            "control simulated drives, instead of reading logs."
        ),
    ] = None,
    recipe: Annotated[
        str | None,
        typer.Option(
            help="Make the suite from measured logs, as a recipe says: med2021-spmsm, or a file "
            ".toml (docs/tasks/score.md). Needs --data."
        ),
    ] = None,
    data: Annotated[Path | None, typer.Option(help="Folder with the recipe's files.")] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for scores.csv, summary.csv and summary.md; default: none."),
    ] = None,
    force: ForceOption = False,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Score an observer on simulated drives with known truth.

    The suite has logs of eight machines on four courses, with three kinds of errors. An entrant
    sees the log and the machine file. With --track closed-loop, it controls the drives; with
    --recipe, the logs are measured ones.

    Scores: position error over all rows and over the rows that the entrant calls valid, coverage of
    its standard deviations, interval score, errors of speed and torque, time per sample. Needs the
    extra "design" (JAX).

    Example: fluxobs score adaptive my_observer.py:Observer --suite suite
    """
    from ...benchmark import entrant, read_suite, score_entrant, summarise, write_suite
    from ...benchmark.entrants import published
    from ...benchmark.report import SUMMARY, text_table, write_report
    from ...benchmark.suite import INDEX
    from ...core.output import make_folder

    names = [n for text in entrants for n in (published() if text == "published" else [text])]
    in_loop = track is Track.closed_loop
    stated = STATED.get(track)
    known = [entrant(name, stated) for name in names]
    if out is not None:
        make_folder(out, SUMMARY, force)  # an error now, not after the runs
    with show.Progress() as progress:
        if (suite / INDEX).exists():
            found = read_suite(suite)
            _check_existing(found, seed, None if in_loop else drives, recipe)
        elif recipe is not None:
            found = _measured(suite, recipe, data, progress)
        else:
            found = write_suite(suite, 1 if seed is None else seed, drives or 1, progress)
        results = []
        for one in known:
            if in_loop:
                from ...benchmark.loop import score_in_loop

                scores = score_in_loop(one, found, drives or 1, progress)
                one = replace(one, track=Track.closed_loop.value)
            else:
                scores = score_entrant(one, found, progress)
            results.append((one, scores, summarise(one, scores)))
    if out is not None:
        write_report(out, found, results)
    summaries = [summary for _, _, summaries in results for summary in summaries]
    if as_json:
        typer.echo(json.dumps([asdict(summary) for summary in summaries]))
    elif not quiet:
        typer.echo(f"{found.title}.")
        typer.echo(text_table(summaries))
        for one, scores, _ in results:
            if not scores:
                typer.echo(f"{one.name}: no observer for the machines of the suite")


def _check_existing(suite: Suite, seed: int | None, drives: int | None, recipe: str | None) -> None:
    """Refuse options of a new suite that an existing one does not have."""
    if seed is not None and seed != suite.seed:
        raise UsageError(
            f"{suite.folder}: exists with seed {suite.seed}; --seed {seed} needs a new folder"
        )
    for option, value in (("--drives", drives), ("--recipe", recipe)):
        if value is not None:
            raise UsageError(f"{suite.folder}: exists; {option} needs a new folder")


def _measured(suite: Path, recipe: str, data: Path | None, progress: show.Progress) -> Suite:
    """Make a suite of measured records."""
    from ...benchmark.measured import read_recipe, write_measured

    name, content = read_recipe(recipe)
    if data is None:
        raise UsageError(
            f"--recipe {recipe} needs --data, the folder with {content.files} of {content.source}"
        )
    return write_measured(suite, name, content, data, progress)
