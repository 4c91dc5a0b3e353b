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
from ..many_logs import are_many, estimate_logs, refuse
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
    from ...presentation import Result


#: Exit code if no row is valid: the estimates are written but not usable.
NEVER_VALID = 3


@reads_logs()
def estimate(
    logs: Annotated[
        list[str],
        typer.Argument(
            metavar="LOG…",
            help="Log file: text (CSV, TXT, LVM, …, also .gz), Parquet, Arrow, npz, npy, JSON, "
            "HDF5, MAT, MDF4, TDMS, ULog or Excel. `fluxobs channels LOG` lists its columns. "
            'Many logs: files, patterns, folders, s3://…, gs://…, http(s)://… (extra "cloud").',
        ),
    ],
    machine: MachineOption,
    layout: dict[str, Any],
    out: Annotated[
        Path | None,
        typer.Option(
            help="File for the estimates, .parquet or .csv; default: print only the summary. With "
            "many logs: a folder for their estimates and a table of all logs."
        ),
    ] = None,
    report: ReportOption = None,
    memory: Annotated[
        float | None,
        typer.Option(
            help="Memory of the least squares in seconds. The default, 0.03 (maglev-2dof: 0.15), "
            "suits most machines."
        ),
    ] = None,
    unknowns: Annotated[
        str,
        typer.Option(
            help="Constant or slow unknowns to estimate. auto (default): drift, resistance, "
            "inverter and asymmetry. drift: only the drift of the flux integral. drift with any "
            "of resistance, inverter, asymmetry: also errors of R_s, of the inverter (dead time, "
            "device drops), and unequal gains of the phases. current-bias or drift,current-bias: "
            "use a slower, general least squares (0.25 ms per row); current-bias alone assumes "
            "that the voltage has no offset."
        ),
    ] = "auto",
    causal: Annotated[
        bool,
        typer.Option(
            "--causal",
            help="Estimate and learn only from past samples, as firmware does. Default: estimate "
            "each row from the rows before and after it.",
        ),
    ] = False,
    prior: PriorOption = None,
    save_machine: Annotated[
        Path | None,
        typer.Option(
            help="Machine file to write, .toml. It contains the learnt parameters; their standard "
            "deviations allow for heating."
        ),
    ] = None,
    save_record: SaveRecordOption = None,
    no_data: Annotated[
        bool,
        typer.Option(
            "--no-data",
            help="Leave the log's samples out of an .html report. The report is then small and "
            "shows the estimates, but cannot recompute them.",
        ),
    ] = False,
    drive: DriveOption = None,
    retry: Annotated[
        str | None,
        typer.Option(
            help="With many logs: estimate the `failed` logs or `all` logs again, even if "
            "unchanged."
        ),
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = "local",
    force: ForceOption = False,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Estimate flux, position and speed from recorded logs.

    Prints a summary with the error budget of the position. --out writes one row per sample, in SI
    units and electrical radians: t, flux_alpha, flux_beta, psi_f, theta_e, speed_e, drift_alpha,
    drift_beta, resistance, inverter_voltage and torque with their standard deviations, speed_mech,
    quality (marks of faulty rows), valid; with --truth also theta_e_error. Exit code 3: no row is
    valid, or most rows do not fit.

    With --causal, --out writes the outputs of the observer: also theta_e_tracked, a second angle
    while two angles are possible, and valid_reason, the number of the reason why a position is not
    valid (docs/outputs.md). For a maglev-2dof, or with current-bias, --out writes flux, position or
    theta_e, drift and current_bias with their standard deviations, and noise_share and valid.

    With many logs, writes a file of estimates per log, and a table with one row per log:
    summary.parquet and summary.csv. The row of a failed log states the reason; the exit code is
    then 1. A repeated command skips logs whose content, machine and settings are unchanged.
    In --machine, `{drive}` is replaced by the name of the drive. `fluxobs fleet DIR` then shows the
    parameters over time.

    Example: fluxobs estimate LOG.csv --machine motor.toml --out estimates.parquet --lag -1
    """
    only_one = {
        "--report": report,
        "--save-machine": save_machine,
        "--save-record": save_record,
        "--no-data": no_data or None,
        "--join": layout.get("join"),
    }
    only_many = {"--drive": drive, "--retry": retry, "--workers": workers}
    if are_many(logs, out):
        refuse(only_one, "works only with one log")
        options = layout | {"unknowns": unknowns, "causal": causal, "memory": memory}
        options |= {"priors": numbers("prior", prior)}
        exit_code = estimate_logs(
            *(logs, machine, out, drive, retry or "none", workers, scheduler),
            options=options,
            quiet=quiet,
            as_json=as_json,
        )
        raise typer.Exit(exit_code)
    refuse(only_many, "works only with many logs")
    log = Path(logs[0])
    from ... import estimate as run
    from ...core.output import check_new
    from ...core.plots import REPORTS, check_path
    from ...logs.meaning.record_files import write_record

    if out is not None:
        refuse_input_as_output(out, machine, layout.get("record"))
    html = report is not None and report.suffix.lower() == ".html"
    if report is not None:
        from ...page import built

        check_path(report)
        check_new(report, REPORTS, force, "--report")
        if html:
            built("report.html")  # fail before the run if the template is missing
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
        check_new(report, REPORTS, force, "--report")  # again: the file may exist by now
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
    unfit = 0 if result.budget is None else result.budget.unfit
    if result.statistics.valid == 0 or 2 * unfit > result.statistics.rows:
        raise typer.Exit(NEVER_VALID)


def show_result(result: Result, machine: str, written: Sequence[Path]) -> None:
    """Print the summary, the files written, and the command that exports the same observer."""
    for note in result.log.notes:
        show.echo(f"Note: {note}.")
    show.summary(result.summary_rows, result.warnings)
    for path in written:
        show.say(f"Written: {path}")
    if result.path is None:
        typer.echo("The estimates are not saved; to save them, add --out FILE.parquet (or .csv).")
    unfit = 0 if result.budget is None else result.budget.unfit
    if result.statistics.valid == 0 or 2 * unfit > result.statistics.rows:
        return
    command = result.export_command(machine)
    if command is not None:
        prefix = "This observer for firmware"
        if result.adaptive is not None and not result.causal:
            prefix = "For firmware (it knows only the past: --causal shows what that costs)"
        show.say(f"{prefix}: {command}")
    elif result.firmware is not None:
        show.say(result.firmware)
