"""`fluxobs channels`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from .. import show
from ..options import JsonOption, LogArgument


def channels(
    log: LogArgument,
    join: Annotated[
        list[Path] | None, typer.Option(metavar="FILE", help="A further file of the same run.")
    ] = None,
    header: Annotated[
        str | None, typer.Option(metavar="NAMES", help="Names for a file without.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """List the columns of a log: unit, rate, range, first values, and what each is taken for.

    Example: fluxobs channels LOG.csv
    """
    from ...logs.channels import list_channels

    listing = list_channels(log, *(join or []), header=header)
    if as_json:
        facts = [one.facts for one in listing.channels]
        typer.echo(json.dumps({"channels": facts, "notes": listing.notes}, indent=1))
        return
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for title in ("column", "unit", "rate [Hz]", "rows", "range", "first values", "taken for"):
        table.add_column(title, overflow="fold")
    for one in listing.channels:
        rate = "" if one.sample_time is None else f"{1 / one.sample_time:.6g}"
        span = "" if one.low != one.low else f"{one.low:.4g} … {one.high:.4g}"
        first = ", ".join(f"{value:.4g}" for value in one.first)
        row = (one.column, one.unit, rate, str(one.rows), span, first, one.taken_for)
        table.add_row(*map(show.cell, row))
    show.table(table)
    for note in listing.notes:
        show.echo(f"Note: {note}")
