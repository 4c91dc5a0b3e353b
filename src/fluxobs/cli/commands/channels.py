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
        list[Path] | None,
        typer.Option(
            metavar="FILE", help="Another file of the same run; the option may be repeated."
        ),
    ] = None,
    header: Annotated[
        str | None, typer.Option(metavar="NAMES", help="Column names of a file without a header.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """List the columns of a log.

    Shows unit, rate, range, first values and channel of each column.

    Example: fluxobs channels LOG.csv
    """
    from ...logs.meaning.channels import list_channels

    listing = list_channels(log, *(join or []), header=header)
    if as_json:
        facts = [channel.facts for channel in listing.channels]
        typer.echo(json.dumps({"channels": facts, "notes": listing.notes}, indent=1))
        return
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for title in ("column", "unit", "rate [Hz]", "rows", "range", "first values", "taken for"):
        table.add_column(title, overflow="fold")
    for channel in listing.channels:
        rate = "" if channel.sample_time is None else f"{1 / channel.sample_time:.6g}"
        value_range = (
            "" if channel.low != channel.low else f"{channel.low:.4g} … {channel.high:.4g}"
        )
        first_values = ", ".join(f"{value:.4g}" for value in channel.first)
        row = (
            channel.column,
            channel.unit,
            rate,
            str(channel.rows),
            value_range,
            first_values,
            channel.taken_for,
        )
        table.add_row(*map(show.cell, row))
    show.table(table)
    for note in listing.notes:
        show.echo(f"Note: {note}")
