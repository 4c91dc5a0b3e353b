"""`fluxobs check`."""

from __future__ import annotations

from typing import Any

import typer

from .. import show
from ..options import JsonOption, LogArgument, MachineOption, QuietOption, reads_logs


@reads_logs()
def check(
    log: LogArgument,
    machine: MachineOption,
    layout: dict[str, Any],
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Is a log what you think? Tries the usual mistakes.

    Looks at the columns first: one given twice, raw counts, an angle in degrees, spikes. Then tries
    the current's sign, phase order and frame, lags of the voltage from two samples earlier to two
    later, and scales of the log or of the machine file (line to line √3, rms √2, power-invariant
    √1.5, any factor), and with a true angle its zero, its direction and n_p. Says what fits best,
    how surely, and what the log cannot tell. Exit code 1: something fits better than what was
    given.

    Example: fluxobs check LOG.csv --machine motor.toml --lag -1
    """
    from ... import check as run

    with show.Progress() as progress:
        found = run(log, machine, progress=progress, **layout)
    for line in found.lines():
        show.echo(line)
    if not found.sound:
        raise typer.Exit(1)
