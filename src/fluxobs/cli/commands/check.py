"""`fluxobs check`."""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer

from .. import show
from ..options import (
    ForceOption,
    JsonOption,
    LogArgument,
    MachineOption,
    QuietOption,
    ReportOption,
    reads_logs,
)


@reads_logs()
def check(
    log: LogArgument,
    machine: MachineOption,
    layout: dict[str, Any],
    cold_resistance: Annotated[
        float | None,
        typer.Option(help="Phase resistance at 20 °C [Ω], for the winding temperature."),
    ] = None,
    only_mistakes: Annotated[
        bool, typer.Option("--mistakes", help="Only the usual mistakes, without the page.")
    ] = False,
    report: ReportOption = None,
    force: ForceOption = False,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Is a log what you think? Tries the usual mistakes.

    Looks at the columns first: one given twice, raw counts, an angle in degrees, spikes. Then tries
    the current's sign, phase order and frame, lags of the voltage from two samples earlier to two
    later, and scales of the log or of the machine file (line to line √3, rms √2, power-invariant
    √1.5, any factor), and with a true angle its zero, its direction and n_p. Says what fits best,
    how surely, and what the log cannot tell. Exit code 1: something fits better than what was
    given.

    Then comes the page on the drive: sampling, converters, offsets, R_s and winding temperature,
    magnets, inverter, gains, lag, encoder or Hall sensors, each with value, standard deviation and
    verdict: fine, look at it, or cannot be told from this log, and which test would tell.

    Example: fluxobs check LOG.csv --machine motor.toml --lag -1
    """
    from ... import check as run
    from ...core.output import check_new
    from ...core.plots import REPORTS

    if report is not None:
        check_new(report, REPORTS, force, "--report")
    with show.Progress() as progress:
        found = run(log, machine, cold_resistance=cold_resistance, progress=progress, **layout)
        items = found.items if as_json or report or not (quiet or only_mistakes) else ()
    if as_json:
        typer.echo(json.dumps(found.facts, indent=1, ensure_ascii=False))
    elif quiet:
        for finding in found.mistakes:
            show.say(str(finding))
    else:
        for note in found.log.notes if found.log is not None else ():
            show.echo(f"Note: {note}.")
        for line in found.lines():
            show.echo(line)
        if items:
            show.page(items)
    if report is not None:
        found.write(report, force=force)
        if not (quiet or as_json):
            show.say(f"Written: {report}")
    if not found.sound:
        raise typer.Exit(1)
