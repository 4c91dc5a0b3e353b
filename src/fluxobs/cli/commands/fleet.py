"""`fluxobs fleet`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from .. import show
from ..options import ForceOption, JsonOption, QuietOption

#: Exit code if a drive exceeds a limit, or no log identifies a parameter that has a limit.
CROSSED = 1


def fleet(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="Folder with the results of `fluxobs estimate LOGS… --out DIR`."
        ),
    ],
    limit: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=LOW..HIGH",
            help="Limits for resistance, psi_f, inverter_voltage, offset_alpha or offset_beta in "
            "SI units; NAME=10%: allowed deviation from each drive's first level. The option "
            "may be repeated.",
        ),
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="Report to write, .html; default DIR/fleet.html.")
    ] = None,
    force: ForceOption = False,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Track the parameters of many drives over time.

    Reports changes, trends and exceeded limits.

    A drive is named after the folder of its logs, or by `fluxobs estimate … --drive`. The time of a
    log is the date in its name, or else the time of its file. Exit code 1: a drive exceeds a limit,
    or no log identifies a parameter that has a limit.

    Example: fluxobs fleet results --limit resistance=20% --limit psi_f=-5..5%
    """
    from ...core.output import check_new
    from ...fleets import open_fleet
    from ...fleets import report as reports
    from ...fleets.follow import follow, read_limit, untold

    limits = [read_limit(text) for text in limit or []]
    opened = open_fleet(folder)
    report_path = folder / "fleet.html" if report is None else report
    if report is not None:
        check_new(report, (".html",), force, "--report")
    followed = follow(opened.table, limits)
    reports.write_html(opened, followed, report_path)
    missing = untold(followed, limits)
    exceeded = any(parameter.crossed for parameter in followed)
    if as_json:
        parameter_facts = [
            {
                "drive": parameter.drive,
                "parameter": parameter.name,
                "unit": parameter.unit,
                "logs": len(parameter.values),
                "first": parameter.first,
                "now": parameter.level,
                "scatter": parameter.course.scatter,
                "crossed": parameter.crossed,
                "remarks": list(parameter.remarks),
            }
            for parameter in followed
        ]
        summary = {"followed": parameter_facts, "untold": missing, "written": str(report_path)}
        typer.echo(json.dumps(summary, ensure_ascii=False))
    elif not quiet:
        show.echo(reports.headline(opened, followed))
        for text in (
            *reports.remarks(followed),
            *(f"{message.capitalize()}." for message in missing),
        ):
            show.echo(text)
        show.say(f"Written: {report_path}")
    if exceeded or missing:
        raise typer.Exit(CROSSED)
