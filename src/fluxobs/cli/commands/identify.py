"""`fluxobs identify`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from ...errors import UsageError
from .. import show
from ..many_logs import SOME_FAILED, are_many
from ..options import (
    ForceOption,
    JsonOption,
    MachineOption,
    QuietOption,
    SchedulerOption,
    WorkersOption,
    reads_logs,
    refuse_input_as_output,
)


@reads_logs()
def identify(
    logs: Annotated[
        list[str],
        typer.Argument(
            metavar="LOG…",
            help="A log that `fluxobs estimate` can read; or many logs of one machine: files, "
            "patterns, folders.",
        ),
    ],
    machine: MachineOption,
    layout: dict[str, Any],
    out: Annotated[
        Path | None,
        typer.Option(help="Machine file to write, .toml; default: only print the values."),
    ] = None,
    free: Annotated[
        str | None,
        typer.Option(
            help="Parameters to identify: R_s, L_s (or L_d, L_q; L_sigma), psi_f (psi_R), map, "
            "R_R, L_M, inverter, lag, J, friction (viscous, coulomb). map: the saturation of the "
            "machine. J: the inertia of the drive. R_R, L_M: the cage of an "
            "induction machine, identifiable if the flux changes; R_R also with --truth "
            "speed_mech=COLUMN. Default R_s,psi_f,inverter, if the machine has them. Other "
            "parameters keep their values."
        ),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(
            help="Report to write: .html; or a picture (.png, .pdf, .svg) of the parameters over "
            "time, or of a flux map."
        ),
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = "local",
    force: ForceOption = False,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Identify the machine's parameters from one log or many.

    Prints each parameter with its standard deviation; values and deviations are those of `fluxobs
    estimate`. --free adds inductances, a flux map, or the rotor of a cage. Parameters that the log
    cannot identify keep their values, and the output says why. --out writes a machine file with
    the values; `fluxobs estimate` subtracts its inverter loss (inverter_voltage) from the commanded
    voltages. The file does not contain the lag. If nothing fits, or no parameter can be identified,
    no file is written (exit code 2).

    With many logs, identifies each log alone and the machine from all logs. Lists the logs that
    contradict the others and a likely cause: heat, ageing, another motor. Exit code 1: one of many
    logs identifies no parameter.

    Example: fluxobs identify LOG.csv --machine motor.toml --out found.toml --report fit.png
    """
    from ... import identify as run
    from ...core.output import check_new
    from ...core.plots import REPORTS, check_path
    from ...machines.saving import check_machine_file

    paths = _local_paths(logs)
    for path in paths:
        if out is not None:
            refuse_input_as_output(out, path, layout.get("record"))
    if out is not None:
        check_machine_file(out, force)
    if report is not None:
        check_path(report)
        check_new(report, REPORTS, force, "--report")
    some_failed = False
    with show.Progress() as progress:
        if len(paths) > 1:
            from ...identification.pooled import identify_many

            pooled = identify_many(
                paths,
                machine,
                free=free,
                workers=workers,
                scheduler=scheduler,
                progress=progress,
                **layout,
            )
            facts, lines, fit = pooled.facts, pooled.lines(), pooled.together
            some_failed = bool(pooled.failed)
        else:
            fit = run(paths[0], machine, free=free, progress=progress, **layout)
            facts, lines = fit.facts, fit.lines()
        if out is not None:
            fit.write(out, force=force)
        if report is not None:
            check_new(report, REPORTS, force, "--report")  # again: the file may exist by now
            fit.write(report)
    if as_json:
        typer.echo(
            json.dumps(
                facts | {"written": None if out is None else str(out)}, indent=1, ensure_ascii=False
            )
        )
    elif not quiet:
        for line in lines:
            show.echo(line)
        for written in (out, report):
            if written is not None:
                show.say(f"Written: {written}")
    if some_failed:
        raise typer.Exit(SOME_FAILED)


def _local_paths(logs: list[str]) -> list[Path]:
    """Return the files that the names or patterns match."""
    if not are_many(logs, None):
        return [Path(logs[0])]
    from ...fleets.sources import sources

    log_sources = sources(logs)
    for source in log_sources:
        if source.remote:
            raise UsageError(f"{source}: identify reads local files only; download the log first")
    return [Path(source.address) for source in log_sources]
