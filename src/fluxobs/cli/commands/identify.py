"""`fluxobs identify`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from .. import show
from ..options import (
    ForceOption,
    JsonOption,
    LogArgument,
    MachineOption,
    QuietOption,
    reads_logs,
    refuse_input_as_output,
)


@reads_logs()
def identify(
    log: LogArgument,
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
    force: ForceOption = False,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Fit the machine's parameters and the inverter's error to a whole log.

    Prints each parameter with its standard deviation, and says which ones the log cannot tell:
    they are held as given. `fluxobs estimate` reads the machine file written here, and subtracts
    the inverter's error (inverter_voltage) from the commanded voltages. A lag is not part of the
    file. If the log tells nothing, nothing is written (exit code 2).

    Example: fluxobs identify LOG.csv --machine motor.toml --out found.toml --report fit.png
    """
    from ... import identify as run
    from ...machines.written import check_machine_file
    from ...output import check_new

    refuse_input_as_output(out, log, layout.get("record"))
    check_machine_file(out, force)
    if report is not None:
        from ...plots import REPORTS, check_path

        check_path(report)
        check_new(report, REPORTS, force, "--report")
    with show.Progress():
        found = run(log, machine, free=free, **layout)
        found.write(out, force=force)
        if report is not None:
            found.write(report)
    if as_json:
        typer.echo(json.dumps(found.facts | {"written": str(out)}, indent=1, ensure_ascii=False))
        return
    if quiet:
        return
    for line in found.lines():
        show.echo(line)
    for path in (out, report):
        if path is not None:
            typer.echo(f"Written: {path}")
