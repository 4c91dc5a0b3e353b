"""`fluxobs estimate`."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .. import show
from ..many_logs import are_many, many, refuse
from ..options import (
    DriveOption,
    ForceOption,
    JsonOption,
    MachineOption,
    PriorOption,
    QuietOption,
    ReportOption,
    SaveRecordOption,
    SchedulerOption,
    WorkersOption,
    numbers,
    reads_logs,
    refuse_input_as_output,
)

if TYPE_CHECKING:
    from ...estimation import Result


#: Exit code if no row is valid: the estimates are written, but nothing in them can be used.
NEVER_VALID = 3


@reads_logs()
def estimate(
    logs: Annotated[
        list[str],
        typer.Argument(
            metavar="LOG…",
            help="Text as instruments write it (CSV, TXT, LVM, …, also .gz), Parquet, Arrow, npz, "
            "npy, JSON, HDF5, MAT, MDF4, TDMS, ULog, Excel. `fluxobs channels LOG` shows what it "
            'holds. Many: files, patterns, folders, s3://…, gs://…, http(s)://… (extra "cloud").',
        ),
    ],
    machine: MachineOption,
    layout: dict[str, Any],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Where the estimates go, .parquet or .csv. Without it only the summary is "
            "printed. Of many logs: a folder, with a table of all."
        ),
    ] = None,
    report: ReportOption = None,
    memory: Annotated[
        float | None,
        typer.Option(
            help="Seconds; memory of the least squares. The default, 0.03 (maglev-2dof: 0.15), "
            "suits most machines."
        ),
    ] = None,
    unknowns: Annotated[
        str,
        typer.Option(
            help="Constant or slow unknowns: auto (default): what the log asks for; drift; with "
            "resistance, inverter, asymmetry, in any combination: also errors of R_s, of the "
            "inverter (dead time and device drops), and unequal gains of the phases; current-bias "
            "or drift,current-bias: the slower, general least squares, 0.25 ms per row; "
            "current-bias alone assumes that the voltage has no offset."
        ),
    ] = "auto",
    causal: Annotated[
        bool,
        typer.Option(
            "--causal",
            help="Learn resistance, inverter, … as the log goes, as firmware would; else from the "
            "whole log first.",
        ),
    ] = False,
    prior: PriorOption = None,
    save_machine: Annotated[
        Path | None,
        typer.Option(
            help="Machine file to write, .toml: with the parameters that the log told, and "
            "standard deviations that allow for heat."
        ),
    ] = None,
    save_record: SaveRecordOption = None,
    no_data: Annotated[
        bool,
        typer.Option(
            "--no-data",
            help="Leave the record out of an .html report: it is then small, "
            "shows only the estimates, and does not recompute.",
        ),
    ] = False,
    drive: DriveOption = None,
    retry: Annotated[
        str | None,
        typer.Option(help="Of many: do `failed` ones again, or `all`, although nothing changed."),
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = "local",
    force: ForceOption = False,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Estimate flux, position, speed and drift of a recorded log, or of many.

    Prints a summary. With --out it writes one row per sample, in SI units and electrical radians:
    t, flux_alpha, flux_beta, psi_f, theta_e (directly from the flux), theta_e_tracked, speed_e,
    drift_alpha, drift_beta, theta_e_std, valid; and theta_e_error if a truth is given. Exit code 3:
    no row is valid.

    With more than the drift among the unknowns it also writes resistance, inverter_voltage,
    psi_f of the magnet and drift, each with its standard deviation, and the other angle while two
    are in question. For a maglev-2dof, or with a current bias, it writes flux, position or theta_e,
    drift and current_bias with their standard deviations, noise_share and valid.

    Of many logs each gets a file of estimates and a row in summary.parquet and summary.csv; one
    that cannot be estimated is a row that says why, and exit code 1. What is done is not done again
    while content, machine and settings stay. `{drive}` in --machine stands for a drive's name.
    `fluxobs fleet DIR` follows the parameters over time.

    Example: fluxobs estimate LOG.csv --machine motor.toml --out estimates.parquet --lag -1
    """
    given = {
        "--report": report,
        "--save-machine": save_machine,
        "--save-record": save_record,
        "--no-data": no_data or None,
        "--join": layout.get("join"),
    }
    only_many = {"--drive": drive, "--retry": retry, "--workers": workers}
    if are_many(logs, out):
        refuse(given, "one log")
        options = layout | {"unknowns": unknowns, "causal": causal, "memory": memory}
        options |= {"priors": numbers("prior", prior)}
        code = many(
            *(logs, machine, out, drive, retry or "none", workers, scheduler),
            options=options,
            quiet=quiet,
            as_json=as_json,
        )
        raise typer.Exit(code)
    refuse(only_many, "many logs")
    log = Path(logs[0])
    from ... import estimate as run
    from ...core.output import check_new
    from ...core.plots import REPORTS, check_path
    from ...logs.record_files import write_record

    if out is not None:
        refuse_input_as_output(out, machine, layout.get("record"))
    html = report is not None and report.suffix.lower() == ".html"
    if report is not None:
        from ...page import built

        check_path(report)
        check_new(report, REPORTS, force, "--report")
        if html:
            built("report.html")  # or say now that it is missing
    if save_record is not None:
        check_new(save_record, (".toml",), force, "--save-record")
    if save_machine is not None:
        from ...machines.saving import check_machine_file

        refuse_input_as_output(save_machine, log, layout.get("record"))
        check_machine_file(save_machine, force, "--save-machine")
    with show.Progress() as progress:
        result = run(
            log,
            machine,
            out=out,
            keep=html,
            force=force,
            unknowns=unknowns,
            causal=causal,
            memory=memory,
            priors=numbers("prior", prior),
            progress=progress,
            **layout,
        )
    written = [] if out is None else [out]
    if save_machine is not None:
        result.write(save_machine, force=force)
        written.append(save_machine)
    if save_record is not None:
        write_record(result.log, save_record, force=force)
        written.append(save_record)
    if report is not None:
        check_new(report, REPORTS, force, "--report")  # once more: the run took a while
        result.write(report, data=not no_data, command=shlex.join(["fluxobs", *sys.argv[1:]]))
        written.append(report)
    if as_json:
        facts = result.facts | {"written": [str(path) for path in written]}
        typer.echo(json.dumps(facts, indent=1, ensure_ascii=False))
    elif quiet:
        for warning in result.warnings:
            show.echo(f"Warning: {warning}", err=True)
    else:
        show_result(result, str(machine), written)
    if result.statistics.valid == 0:
        raise typer.Exit(NEVER_VALID)


def show_result(result: Result, machine: str, written: Sequence[Path]) -> None:
    """Print the summary, what was written, and how to export the same observer as firmware."""
    for note in result.log.notes:
        show.echo(f"Note: {note}.")
    show.summary(result.summary, result.warnings)
    for path in written:
        show.say(f"Written: {path}")
    if result.path is None:
        typer.echo("The estimates are not written: --out FILE.parquet (or .csv) says where to.")
    if result.statistics.valid == 0:
        return
    command = result.export_command(machine)
    if command is not None:
        words = "The same in firmware"
        if result.adaptive is not None and not result.causal:
            words += ", which learns as it goes"
        show.say(f"{words}: {command}")
    elif result.firmware is not None:
        show.say(result.firmware)
