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
            help="A log, as `fluxobs estimate` reads it; or many of one machine: files, patterns, "
            "folders.",
        ),
    ],
    machine: MachineOption,
    out: Annotated[Path, typer.Option(help="Machine file to write, .toml.")],
    layout: dict[str, Any],
    free: Annotated[
        str | None,
        typer.Option(
            help="Parameters to fit, out of R_s, L_s (or L_d, L_q; L_sigma), psi_f (psi_R), map, "
            "R_R, L_M, inverter, lag. map: how the machine saturates. R_R, L_M: of a cage, if its "
            "flux changes; or R_R with --truth speed_mech=COLUMN. Default R_s,psi_f,inverter, if "
            "the machine has them; the rest stays as given."
        ),
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="Picture of the residual, and of a map: .png, .pdf, .svg.")
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = "local",
    force: ForceOption = False,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Fit the machine's parameters and the inverter's error to a whole log, or to many.

    Prints each parameter with its standard deviation, and says which ones the log cannot tell:
    they are held as given. `fluxobs estimate` reads the machine file written here, and subtracts
    the inverter's error (inverter_voltage) from the commanded voltages. A lag is not part of the
    file. If the log tells nothing, nothing is written (exit code 2).

    Of many logs pieces are fitted together; each is fitted alone too, and those that disagree are
    named, with what it may be: heat, ageing, another motor. Exit code 1: one of many tells nothing.

    Example: fluxobs identify LOG.csv --machine motor.toml --out found.toml --report fit.png
    """
    from ... import identify as run
    from ...core.output import check_new
    from ...core.plots import REPORTS, check_path
    from ...machines.saving import check_machine_file

    paths = _paths(logs)
    for path in paths:
        refuse_input_as_output(out, path, layout.get("record"))
    check_machine_file(out, force)
    if report is not None:
        check_path(report)
        check_new(report, REPORTS, force, "--report")
    some_failed = False
    with show.Progress() as progress:
        if len(paths) > 1:
            from ...identification.pooled import identify_many

            several = identify_many(
                paths,
                machine,
                free=free,
                workers=workers,
                scheduler=scheduler,
                progress=progress,
                **layout,
            )
            facts, lines, found = several.facts, several.lines(), several.together
            some_failed = bool(several.failed)
        else:
            found = run(paths[0], machine, free=free, **layout)
            facts, lines = found.facts, found.lines()
        found.write(out, force=force)
        if report is not None:
            check_new(report, REPORTS, force, "--report")  # once more: the run took a while
            found.write(report)
    if as_json:
        typer.echo(json.dumps(facts | {"written": str(out)}, indent=1, ensure_ascii=False))
    elif not quiet:
        for line in lines:
            show.echo(line)
        for place in (out, report):
            if place is not None:
                show.say(f"Written: {place}")
    if some_failed:
        raise typer.Exit(SOME_FAILED)


def _paths(logs: list[str]) -> list[Path]:
    """The files that are meant."""
    if not are_many(logs, None):
        return [Path(logs[0])]
    from ...fleets.sources import sources

    found = sources(logs)
    for one in found:
        if one.remote:
            raise UsageError(f"{one}: identify takes files of this machine; fetch it first")
    return [Path(one.address) for one in found]
