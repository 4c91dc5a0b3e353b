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
        typer.Option(help="Phase resistance at 20 °C in ohms, to compute the winding temperature."),
    ] = None,
    only_mistakes: Annotated[
        bool,
        typer.Option("--mistakes", help="Report only mistakes; skip the examination of the drive."),
    ] = False,
    report: ReportOption = None,
    force: ForceOption = False,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Test a log for the usual mistakes, then examine the drive.

    First checks the columns: duplicates, raw counts, an angle in degrees, spikes. Then tests the
    current (sign, phase order, frame), voltage lags from -2 to 2 samples, scales of the log or of
    the machine file (line to line √3, rms √2, power-invariant √1.5, any factor) and the true angle,
    if given (zero, direction, n_p). Reports which settings fit best, how clearly they do, and what
    this log cannot show. Exit code 1: other settings fit better than the given settings.

    Then examines the drive: sampling, converters, offsets, R_s and winding temperature, magnets,
    inverter, gains, lag, injection and position at rest, encoder or Hall sensors. Each result has a
    value, a standard deviation and a verdict: "fine", "look at it", or "cannot be told" (then it
    names the test that would decide).

    Example: fluxobs check LOG.csv --machine motor.toml --lag -1
    """
    from ... import check as run
    from ...core.output import check_new
    from ...core.plots import REPORTS

    if report is not None:
        check_new(report, REPORTS, force, "--report")
    with show.Progress() as progress:
        examination = run(
            log, machine, cold_resistance=cold_resistance, progress=progress, **layout
        )
        items = examination.items if as_json or report or not (quiet or only_mistakes) else ()
    if as_json:
        typer.echo(json.dumps(examination.facts, indent=1, ensure_ascii=False))
    elif quiet:
        for finding in examination.mistakes:
            show.say(str(finding))
    else:
        for note in examination.log.notes if examination.log is not None else ():
            show.echo(f"Note: {note}.")
        for line in examination.lines():
            show.echo(line)
        if items:
            show.examination(items)
    if report is not None:
        examination.write(report, force=force)
        if not (quiet or as_json):
            show.say(f"Written: {report}")
    if not examination.sound:
        raise typer.Exit(1)
