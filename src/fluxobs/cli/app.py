"""The program: its commands, errors and exit codes.

To start quickly, each command imports what it needs only when it runs.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from collections.abc import Iterable
from contextlib import suppress
from importlib.metadata import version
from typing import Annotated

import typer

from ..errors import FluxobsError, name_flags
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
from .commands.plan import plan, plan_test
from .commands.presets import presets
from .commands.reproduce import reproduce
from .commands.score import score
from .options import REPEATED
from .show import Stopped, echo

#: Parameter of mallopt in glibc.
M_ARENA_MAX = -8
HELP = """
Estimate flux, rotor position, speed and drift from a drive's measured currents and voltages, which
may have offsets.

Try it:

    fluxobs demo

Your own log (CSV, MDF, MAT, TDMS, …), with a machine file or the name of a shipped machine:

    fluxobs estimate LOG.csv --machine motor.toml --out estimates.parquet --report report.png

`fluxobs COMMAND --help` lists the options. Exit codes: 0 success; 1 `check` found a mistake,
a limit of `campaign` or `fleet` is not met, or one of many logs failed; 2 unusable input; 3 no
row is valid, or most do not fit.
"""

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help=HELP,
)


def _show_version(requested: bool) -> None:
    if requested:
        typer.echo(f"fluxobs {version('fluxobs')}")
        raise typer.Exit


@app.callback()
def _options(
    version_requested: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    pass


COMMANDS = (
    *(estimate, check, channels, identify, plan_test, fleet, compare, score, campaign, export),
    *(live, page, machines, presets, demo, reproduce),
)
for command in COMMANDS:
    app.command(name=command.__name__.replace("_", "-"))(command)
machine.command(name="plan")(plan)
app.add_typer(machine, name="machine")


def repeat_options(arguments: Iterable[str]) -> list[str]:
    """Expand ``--column a=b c=d`` to ``--column a=b --column c=d``."""
    expanded: list[str] = []
    option, values = None, 0
    for argument in arguments:
        if argument.startswith("--"):
            name, joined, _ = argument.partition("=")
            option = name if name in REPEATED else None
            values = 1 if joined else 0
        elif option is not None and "=" in argument:
            if values:
                expanded.append(option)
            values += 1
        else:
            option = None
        expanded.append(argument)
    return expanded


def _stop_threads() -> None:
    """End what threads compute: the program's end waits for them."""
    smoother = sys.modules.get("fluxobs._smoother")
    if smoother is not None:
        smoother.stop()


def _raise_stopped(number: int, frame: object) -> None:
    _stop_threads()
    raise Stopped


def _exit(number: int, frame: object) -> None:
    _stop_threads()
    sys.exit(128 + number)


def _use_one_arena() -> None:
    """Let all threads of glibc allocate from one arena.

    The threads that smooth a long log would otherwise keep a quarter of a gigabyte of freed memory.
    """
    with suppress(OSError, AttributeError, TypeError):  # another C library
        ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)


def main() -> None:
    """Run the program; on unusable input print a message and exit with code 2."""
    _use_one_arena()
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if (
            number is not None and signal.getsignal(number) is signal.SIG_DFL
        ):  # keep nohup's setting
            signal.signal(number, _exit)
    signal.signal(signal.SIGINT, _raise_stopped)
    before = name_flags(True)
    try:
        app(args=repeat_options(sys.argv[1:]), prog_name="fluxobs")
    except Stopped as stopped:
        typer.echo(f"Stopped by Ctrl-C{stopped.progress}; {stopped.consequence}.", err=True)
        raise
    except FluxobsError as error:
        echo(f"Error: {error}", err=True)
        raise SystemExit(2) from None
    except OSError as error:
        if error.strerror is None or isinstance(error.filename, int | None):  # no file has a name
            raise
        echo(f"Error: {os.fsdecode(error.filename)}: {error.strerror.lower()}", err=True)
        raise SystemExit(2) from None
    finally:
        name_flags(before)
