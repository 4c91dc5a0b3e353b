"""A report is one HTML file with the run, its pictures and, if small enough, its record."""

from __future__ import annotations

import shlex
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from .. import page as web
from ..checking.findings import Check
from ..core.output import write_text
from ..estimation.run import LogRun
from ..logs.log import Log
from ..machines.file_text import machine_text
from ..observers import ImmersionObserver
from ..page.columns import exact, flags, rounded
from .plot_data import shown, signals
from .result import Result

#: Longest encoded record in a report [characters]. Without the record, a report cannot recompute.
MAX_RECORD_SIZE = 8_000_000
#: Largest record in a report [rows]. To recompute more rows would take more than a few seconds.
MAX_RECORD_ROWS = 1_000_000
#: Columns of the estimates that no picture shows.
NOT_SHOWN = (
    *("flux_alpha", "flux_beta", "theta_e_tracked", "theta_e_other"),
    *("torque", "speed_mech", "speed_mech_std"),
)


def write_report(
    result: Result, path: Path, *, command: str | None = None, data: bool = True
) -> None:
    """Write the report of a run.

    Parameters
    ----------
    result : Result
        Its estimates are in memory or in a file.
    path : Path
        Ends in .html.
    command : str, optional
        The command that produced the run; the report shows it.
    data : bool
        Whether to include the record, so that a reader can recompute with other parameters.

    Raises
    ------
    FluxobsError
        The file cannot be written, or this installation has no template.
    """
    template = web.built("report.html")
    record = (
        _record(result) if data and not isinstance(result.observer, ImmersionObserver) else None
    )
    page_data = {
        "words": _texts(result, command),
        "found": shown(result),
        "record": record,
        "columns": None if record is not None else _columns(result),
    }
    write_text(path, web.with_data(template, page_data))


def _texts(result: Result, command: str | None) -> dict[str, Any]:
    checked: Check | None = result.checked
    findings = () if checked is None else checked.findings
    return {
        "log": result.log.path.name,
        "machine": machine_text(result.machine, [], {}),
        "summary": [list(row) for row in result.summary_rows],
        "warnings": result.warnings,
        "notes": list(result.log.notes),
        "taken": _channel_rows(result.log),
        "findings": [item.facts for item in findings],
        "check_notes": [] if checked is None else checked.lines()[len(findings) :],
        "commands": [
            item for item in (command, result.export_command(_machine_in(command))) if item
        ],
    }


def _machine_in(command: str | None) -> str:
    """Return the argument of --machine in a command."""
    words = shlex.split(command or "")
    return next(
        (following for word, following in pairwise(words) if word == "--machine"), "MACHINE"
    )


def _channel_rows(log: Log) -> list[list[str]]:
    """Return rows (channel, column, conversion), one per channel."""
    rows = []
    for channel, column in log.names.items():
        scale, offset = log.conversions.get(channel, (1.0, 0.0))
        conversion = f"× {scale:.6g}" if scale != 1.0 else ""
        conversion += f" + {offset:.6g}" if offset else ""
        rows.append([channel, column, conversion.strip() or "as it is"])
    if log.true is not None:
        rows.append([log.true.channel, " ".join(log.true.columns), "true, for the score"])
    return rows


def _record(result: LogRun) -> dict[str, Any] | None:
    """Return the channels of the log and the options to read them; None if the log is too large."""
    log = result.log
    if len(log) > MAX_RECORD_ROWS or getattr(result.machine, "flux_map", None) is not None:
        return None
    batches = list(log.channels(log.first, log.last))
    columns = {name: np.concatenate([batch[name] for batch in batches]) for name in batches[0]}
    columns.pop("t", None)
    true = None if log.true is None else log.true.channel
    packed = {name: exact(values) for name, values in columns.items()}
    if sum(len(column["data"]) for column in packed.values()) > MAX_RECORD_SIZE:
        return None
    rows = np.arange(log.first, log.last)
    return {
        "columns": packed,
        "t": exact(log.clock.times(rows)) if len(log.clock.at) > 1 else None,
        "start": float(log.clock.times(rows[:1])[0]),
        "layout": {
            "frame": log.frame,
            "currents": log.layout.currents,
            "sample_time": log.sample_time,
            "lag": log.layout.lag,
            "held": log.layout.held,
            "truth": true,
            "fit_truth": log.layout.fit_truth,
        },
        "unknowns": list(result.unknowns),
        "causal": result.causal,
        "memory": result.memory,
        "priors": dict(result.priors),
    }


def _columns(result: Result) -> dict[str, Any]:
    """Return the estimates; their rounding is finer than their noise."""
    table = result.estimates
    columns: dict[str, Any] = {}
    for name in table.columns:
        values = table[name].to_numpy()
        if name == "valid":
            columns[name] = flags(values.astype(bool))
        elif name == "t":
            columns[name] = exact(values.astype(float))
        elif name not in NOT_SHOWN:
            columns[name] = rounded(values.astype(float))
    angles = [table[n].to_numpy() if n in table.columns else None for n in ("theta_e", "speed_e")]
    lag = None if result.lag is None else result.lag.lag
    for name, values in signals(result.log, result.machine.ports, lag, *angles).items():
        columns[name] = rounded(values)
    return columns
