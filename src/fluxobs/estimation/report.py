"""A report: one HTML file with the run, its pictures, and where it fits in, the record itself."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from .. import page as web
from ..checking.findings import Check
from ..core.output import write_text
from ..logs.log import Log
from ..machines.file_text import machine_text
from ..observers import ImmersionObserver
from ..page.columns import exact, flags, rounded
from .plot_data import shown
from .result import Result
from .run import LogRun

#: A record of more text than this is left out: the report then shows, but does not recompute.
MOST = 8_000_000
#: Nor is a record of more rows: a reader would wait for more than a few seconds.
MOST_ROWS = 1_000_000
#: Columns of estimates that the pictures do not show.
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
        With its estimates in memory or in a file.
    path : Path
        Ends in .html.
    command : str, optional
        The command that made it.
    data : bool
        Whether the record is inside, so that a reader can run it again with other parameters.

    Raises
    ------
    FluxobsError
        The file cannot be written, or this installation has no template.
    """
    template = web.built("report.html")
    record = (
        _record(result) if data and not isinstance(result.observer, ImmersionObserver) else None
    )
    found = {
        "words": _words(result, command),
        "found": shown(result),
        "record": record,
        "columns": None if record is not None else _columns(result),
    }
    write_text(path, web.with_data(template, found))


def _words(result: Result, command: str | None) -> dict[str, Any]:
    checked: Check | None = result.checked
    findings = () if checked is None else checked.findings
    return {
        "log": result.log.path.name,
        "machine": machine_text(result.machine, [], {}),
        "summary": result.summary,
        "warnings": result.warnings,
        "notes": list(result.log.notes),
        "taken": _taken(result.log),
        "findings": [one.facts for one in findings],
        "check_notes": [] if checked is None else checked.lines()[len(findings) :],
        "commands": [one for one in (command, result.export_command(_machine_in(command))) if one],
        "parameters": _learnt(result),
    }


def _machine_in(command: str | None) -> str:
    """What a command names as the machine."""
    words = shlex.split(command or "")
    return next((after for word, after in pairwise(words) if word == "--machine"), "MACHINE")


def _taken(log: Log) -> list[list[str]]:
    """Channel, column, and what turns one into the other."""
    out = []
    for channel, column in log.names.items():
        scale, offset = log.conversions.get(channel, (1.0, 0.0))
        words = f"× {scale:.6g}" if scale != 1.0 else ""
        words += f" + {offset:.6g}" if offset else ""
        out.append([channel, column, words.strip() or "as it is"])
    if log.true is not None:
        out.append([log.true.channel, " ".join(log.true.columns), "true, for the score"])
    return out


def _learnt(result: Result) -> list[list[str]]:
    found: Mapping[str, Any] = result.facts["parameters"]
    return [
        [name, f"{one['value']:.6g}", f"{2 * one['std']:.2g}", one["unit"], f"{one['given']:.6g}"]
        for name, one in found.items()
    ]


def _record(result: LogRun) -> dict[str, Any] | None:
    """The channels of the log with all that reading them again needs; None if they are too many."""
    log = result.log
    if len(log) > MOST_ROWS or getattr(result.machine, "flux_map", None) is not None:
        return None
    parts = list(log.channels(log.first, log.last))
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    columns.pop("t", None)
    true = None if log.true is None else log.true.channel
    packed = {name: exact(values) for name, values in columns.items()}
    if sum(len(one["data"]) for one in packed.values()) > MOST:
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
    """The estimates, rounded below their own noise."""
    table = result.estimates
    out: dict[str, Any] = {}
    for name in table.columns:
        values = table[name].to_numpy()
        if name == "valid":
            out[name] = flags(values.astype(bool))
        elif name == "t":
            out[name] = exact(values.astype(float))
        elif name not in NOT_SHOWN:
            out[name] = rounded(values.astype(float))
    return out
