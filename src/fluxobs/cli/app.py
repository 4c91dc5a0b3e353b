"""The program: its commands, its errors, its exit codes. Start-up time counts: a command loads
what it needs when it runs.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterable
from importlib.metadata import version
from typing import Annotated

import typer

from ..errors import FluxobsError
from .commands.campaign import campaign
from .commands.channels import channels
from .commands.check import check
from .commands.compare import compare
from .commands.demo import demo
from .commands.estimate import estimate
from .commands.export import export
from .commands.fleet import fleet
from .commands.identify import identify
from .commands.live import live
from .commands.machine import app as machine
from .commands.machines import machines
from .commands.page import page
from .commands.presets import presets
from .commands.reproduce import reproduce
from .options import REPEATED
from .show import Stopped, echo

HELP = """
Flux, rotor position, speed and sensor drift from a drive's currents and voltages, both biased.

**Try it:**

    fluxobs demo

**Your own log** (CSV, MDF, MAT, TDMS, …), with a machine file or the name of a shipped machine:

    fluxobs estimate LOG.csv --machine motor.toml --out estimates.parquet --report report.png

`fluxobs COMMAND --help` has the options. Exit codes: 0 done, 1 `check` found a mistake,
`campaign` or `fleet` a limit that is missed, one of many logs failed, 2 unusable input, 3 the
position is never valid.
"""

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help=HELP,
)


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"fluxobs {version('fluxobs')}")
        raise typer.Exit


@app.callback()
def _options(
    asked: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    pass


COMMANDS = (
    *(estimate, check, channels, identify, fleet, compare, campaign, export),
    *(live, page, machines, presets, demo, reproduce),
)
for command in COMMANDS:
    app.command(name=command.__name__)(command)
app.add_typer(machine, name="machine")


def spread(arguments: Iterable[str]) -> list[str]:
    """``--column a=b c=d`` means the same as ``--column a=b --column c=d``."""
    out: list[str] = []
    option, taken = None, 0
    for argument in arguments:
        if argument.startswith("--"):
            name, joined, _ = argument.partition("=")
            option = name if name in REPEATED else None
            taken = 1 if joined else 0
        elif option is not None and "=" in argument:
            if taken:
                out.append(option)
            taken += 1
        else:
            option = None
        out.append(argument)
    return out


def _stop(number: int, frame: object) -> None:
    raise Stopped


def main() -> None:
    """Entry point; unusable input ends with a message and exit code 2."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    for end in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, end, None)
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:  # not under nohup
            signal.signal(number, lambda number, frame: sys.exit(128 + number))
    signal.signal(signal.SIGINT, _stop)
    try:
        app(args=spread(sys.argv[1:]), prog_name="fluxobs")
    except Stopped as end:
        typer.echo(f"Stopped by Ctrl-C{end.where}; {end.left}.", err=True)
        raise
    except FluxobsError as error:
        echo(f"Error: {error}", err=True)
        raise SystemExit(2) from None
