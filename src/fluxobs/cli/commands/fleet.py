"""`fluxobs fleet`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from .. import show
from ..options import ForceOption, JsonOption, QuietOption

#: Exit code if a drive is beyond a limit, or none tells.
CROSSED = 1


def fleet(
    folder: Annotated[
        Path,
        typer.Argument(metavar="DIR", help="Results of `fluxobs estimate LOGS… --out DIR`."),
    ],
    limit: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=LOW..HIGH",
            help="Bounds of resistance, psi_f, inverter_voltage, offset_alpha, offset_beta in SI; "
            "NAME=10%: of each drive's first level. May be repeated.",
        ),
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="Report, .html; default DIR/fleet.html.")
    ] = None,
    force: ForceOption = False,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Follow the parameters of many drives over time: what changed, when, what is out of limits.

    A drive is the folder of its logs, or what `fluxobs estimate … --drive` found; a log's time is
    the date in its name, else its file's. Exit code 1: a drive is beyond a limit, or no log tells
    what a limit is on.

    Example: fluxobs fleet results --limit resistance=20% --limit psi_f=-5..5%
    """
    from ...core.output import check_new
    from ...fleets import open_fleet
    from ...fleets import report as reports
    from ...fleets.follow import follow, read_limit, untold

    limits = [read_limit(text) for text in limit or []]
    found_fleet = open_fleet(folder)
    place = folder / "fleet.html" if report is None else report
    if report is not None:
        check_new(report, (".html",), force, "--report")
    found = follow(found_fleet.table, limits)
    reports.write_html(found_fleet, found, place)
    missing = untold(found, limits)
    crossed = any(one.crossed for one in found)
    if as_json:
        facts = [
            {
                "drive": one.drive,
                "parameter": one.name,
                "unit": one.unit,
                "logs": len(one.values),
                "first": one.first,
                "now": one.level,
                "scatter": one.course.scatter,
                "crossed": one.crossed,
                "remarks": list(one.remarks),
            }
            for one in found
        ]
        told = {"followed": facts, "untold": missing, "written": str(place)}
        typer.echo(json.dumps(told, ensure_ascii=False))
    elif not quiet:
        show.echo(reports.headline(found_fleet, found))
        for text in (*reports.remarks(found), *(f"{one.capitalize()}." for one in missing)):
            show.echo(text)
        show.say(f"Written: {place}")
    if crossed or missing:
        raise typer.Exit(CROSSED)
