"""`fluxobs score`."""

from __future__ import annotations

import json
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from .. import show
from ..options import ForceOption, JsonOption, QuietOption


class Track(StrEnum):
    """Tracks of the benchmark."""

    offline = "offline"
    causal = "causal"


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
        int,
        typer.Option(min=0, help="Seed of a new suite: 1 is public, whoever judges takes another."),
    ] = 1,
    drives: Annotated[
        int,
        typer.Option(min=1, help="Drives of each machine, course and kind of errors, if new."),
    ] = 1,
    track: Annotated[Track | None, typer.Option(help="Track of a folder of estimates.")] = None,
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
    sees the log and the machine file. Scores: position error over all rows and over the rows that
    the entrant calls valid, coverage of its standard deviations, interval score, errors of speed
    and torque, time per sample. Needs the extra "design" (JAX).

    Example: fluxobs score adaptive my_observer.py:Observer --suite suite
    """
    from ...benchmark import entrant, read_suite, score_entrant, summarise, write_suite
    from ...benchmark.entrants import published
    from ...benchmark.report import SUMMARY, text_table, write_report
    from ...benchmark.suite import INDEX
    from ...core.output import make_folder

    names = [n for text in entrants for n in (published() if text == "published" else [text])]
    known = [entrant(name, None if track is None else track.value) for name in names]
    if out is not None:
        make_folder(out, SUMMARY, force)  # an error now, not after the runs
    with show.Progress() as progress:
        found = read_suite(suite) if (suite / INDEX).exists() else None
        if found is None:
            found = write_suite(suite, seed, drives, progress)
        results = []
        for one in known:
            scores = score_entrant(one, found, progress)
            results.append((one, scores, summarise(one, scores)))
    if out is not None:
        write_report(out, found, results)
    summaries = [summary for _, _, summaries in results for summary in summaries]
    if as_json:
        typer.echo(json.dumps([asdict(summary) for summary in summaries]))
    elif not quiet:
        typer.echo(f"Suite {found.version}, seed {found.seed}: {len(found.entries)} records.")
        typer.echo(text_table(summaries))
