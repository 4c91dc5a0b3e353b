"""Recognise, estimate and summarise many logs for the commands."""

from __future__ import annotations

import glob
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer

from ..errors import UsageError
from . import show

if TYPE_CHECKING:
    from ..fleets import Fleet

#: Exit code if some of many logs cannot be estimated.
SOME_FAILED = 1
#: Rows printed on the terminal.
SHOWN = 20


def are_many(logs: Sequence[str], out: Path | None) -> bool:
    """Return whether `logs` names many logs: several names, a folder, a pattern or a URL.

    A single log also counts as many if `out` already holds the results of many logs.

    Raises
    ------
    UsageError
        The name contains wildcards, but neither exists nor matches a file.
    """
    if len(logs) > 1 or (out is not None and out.is_dir() and (out / "fleet.json").exists()):
        return True
    log = logs[0]
    if "://" in log or Path(log).is_dir():
        return True
    if Path(log).exists() or not glob.has_magic(log):
        return False
    if not glob.glob(log, recursive=True):
        raise UsageError(f"{log}: no such file, and no file matches this pattern")
    return True


def refuse(options: Mapping[str, Any], reason: str) -> None:
    """Raise UsageError, "OPTION `reason`", if one of these options is given."""
    for name, value in options.items():
        if value is not None:
            raise UsageError(f"{name} {reason}")


def estimate_logs(
    logs: Sequence[str],
    machine: Path,
    out: Path | None,
    drive: str | None,
    retry: str,
    workers: int | None,
    scheduler: str,
    *,
    options: dict[str, Any],
    quiet: bool,
    as_json: bool,
) -> int:
    """Estimate many logs, print a summary, and return the exit code."""
    from ..fleets import estimate_many

    if out is None:
        prefix = f"{logs[0]} is a folder: " if Path(logs[0]).is_dir() else ""
        raise UsageError(f"{prefix}--out is missing: give a folder for the results of many logs")
    if out.suffix in (".parquet", ".csv"):
        prefix = f"{logs[0]}: this is a folder, not a log; " if Path(logs[0]).is_dir() else ""
        raise UsageError(f"{prefix}--out {out}: for many logs, give a folder")
    any_retry: Any = retry
    retry_mode: Literal["none", "failed", "all"] = any_retry
    with show.Progress("finished logs are kept; run the same command to resume") as progress:
        fleet = estimate_many(
            *(logs, machine, out),
            drive=drive,
            retry=retry_mode,
            workers=workers,
            scheduler=scheduler,
            progress=progress,
            **{name: value for name, value in options.items() if value is not None},
        )
    failed = fleet.failed
    if as_json:
        facts = {"logs": len(fleet.table), "failed": failed["log"].to_list(), "out": str(out)}
        typer.echo(json.dumps(facts, indent=1, ensure_ascii=False))
    else:
        _show(fleet, quiet)
    return SOME_FAILED if len(failed) else 0


def _show(fleet: Fleet, quiet: bool) -> None:
    from rich.table import Table

    from ..presentation.summary import si

    failed = fleet.failed
    estimated = len(fleet.table) - len(failed)
    if not quiet:
        rich_table = Table(box=None, pad_edge=False)
        for k, title in enumerate(("log", "rows", "valid", "R_s", "psi_f", "V_d", "error rms", "")):
            rich_table.add_column(
                title, justify="left" if k in (0, 7) else "right", overflow="fold"
            )
        for row in fleet.table.head(SHOWN).iter_rows(named=True):

            def value(name: str, unit: str, row: dict[str, Any] = row) -> str:
                if row[name] is None:
                    return "–"
                return f"{si(row[name], unit)} ± {si(row[f'{name}_std'], unit)}"

            remark = "failed" if row["failed"] else "look at it" if row["mistakes"] else ""
            error = row["error_rms"]
            rich_table.add_row(
                show.cell(row["log"]),
                "–" if row["rows"] is None else str(row["rows"]),
                "–" if row["valid"] is None else f"{row['valid']:.1%}",
                value("resistance", "Ω"),
                value("psi_f", "Wb"),
                value("inverter_voltage", "V"),
                "–" if error is None else f"{57.29577951308232 * error:.2f}°",
                remark,
            )
        show.table(rich_table)
        if len(fleet.table) > SHOWN:
            show.echo(f"… and {len(fleet.table) - SHOWN} more.")
        show.echo(f"{estimated} of {len(fleet.table)} logs estimated.")
    for row in failed.head(SHOWN).iter_rows(named=True):
        show.echo(f"Failed: {row['failed']}", err=True)
    if len(failed) > SHOWN:
        show.say(f"… and {len(failed) - SHOWN} more failed; see summary.csv", err=True)
    if not quiet:
        show.say(f"Written: {fleet.folder}/summary.parquet, summary.csv, estimates/")
