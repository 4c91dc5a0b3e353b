"""`fluxobs check`."""

from __future__ import annotations

from typing import Any

import typer

from .. import show
from ..options import LogArgument, MachineOption, reads_logs


@reads_logs("truth")
def check(log: LogArgument, machine: MachineOption, layout: dict[str, Any]) -> None:
    """Is a log what you think? Tries the usual mistakes.

    Tries all combinations of the current's sign, phase order, and lags of the voltage from two
    samples earlier to two later. Judges scales (line to line √3, rms √2, power-invariant √1.5), and
    R_s per phase or line to line, by the resistance and the magnet flux that fit. Says what fits
    best, how surely, and what the log cannot tell. Exit code 1: something else fits better than
    what was given.

    Example: fluxobs check LOG.csv --machine motor.toml --lag -1
    """
    from ... import check as run

    found = run(log, machine, **layout)
    for line in found.lines():
        show.echo(line)
    if not found.sound:
        raise typer.Exit(1)
