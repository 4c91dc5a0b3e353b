"""Options that several commands share. Their names are those of the library's arguments.

The layout of a log takes a dozen options, defined once in :data:`LAYOUT`. A command that reads logs
is decorated with :func:`reads_logs` and gets them as one mapping, ``layout``.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import FluxobsError, RecordError

Pairs = list[str] | None

MachineOption = Annotated[
    Path, typer.Option(help="TOML with kind, R_s, … in SI; or a name from `fluxobs machines`.")
]
LogArgument = Annotated[
    Path,
    typer.Argument(metavar="LOG", help="CSV (any delimiter), Parquet or npz; a column a channel."),
]
ReportOption = Annotated[Path | None, typer.Option(help="Picture: .png, .pdf or .svg.")]
PriorOption = Annotated[
    Pairs,
    typer.Option(
        "--prior",
        "--priors",
        metavar="NAME=NUMBER",
        help="resistance=OHM, inverter=VOLT, psi_f=WB, asymmetry=NUMBER: standard deviations of "
        "the machine file's values. Default: half of R_s; a quarter of R_s times the rated "
        "current (a log's voltage may make it more); a quarter of psi_f; 0.01.",
    ),
]

#: Options of every command that reads a log: name of the argument → annotation.
LAYOUT: dict[str, Any] = {
    "record": Annotated[
        Path | None, typer.Option(help="TOML with frame, lag, columns, …; options override it.")
    ],
    "frame": Annotated[
        str | None,
        typer.Option(
            help="alphabeta (u_alpha u_beta i_alpha i_beta), abc (u_a … i_c; or two currents), "
            "line (u_ab u_bc), duty (d_a d_b d_c udc), dq (u_d u_q i_d i_q theta_e; a voltage is "
            "turned by the angle in the middle of the interval it acts over), ports (u_1 u_2 "
            "i_1 i_2: maglev-2dof). Default alphabeta, or ports."
        ),
    ],
    "sample_time": Annotated[
        float | None, typer.Option(help="Seconds; needed if there is no column t.")
    ],
    "lag": Annotated[
        float | None,
        typer.Option(
            help="Samples. 0 (default): a row's voltage acts from that row to the next; -1: one "
            "sample later (usual computation delay); +1: one earlier; fractions allowed."
        ),
    ],
    "held": Annotated[
        bool | None,
        typer.Option(
            "--held/--not-held",
            help="Whether each voltage is held over its sample, as an inverter's mean voltage is. "
            "Default: if it matters for the machine, R h/L above 0.15.",
        ),
    ],
    "columns": Annotated[
        Pairs,
        typer.Option(
            "--column",
            "--columns",
            metavar="CHANNEL=COLUMN",
            help="The column of a channel; udc=540 sets a constant DC-link voltage, t=- ignores a "
            "column t.",
        ),
    ],
    "scale": Annotated[
        Pairs, typer.Option(metavar="CHANNEL=NUMBER", help="A channel is scale · column + offset.")
    ],
    "offset": Annotated[
        Pairs, typer.Option(metavar="CHANNEL=NUMBER", help="A channel is scale · column + offset.")
    ],
    "start": Annotated[
        float | None, typer.Option("--from", "--start", help="Seconds; use rows from then on.")
    ],
    "stop": Annotated[
        float | None, typer.Option("--to", "--stop", help="Seconds; use rows until then.")
    ],
    "truth": Annotated[
        Pairs,
        typer.Option(
            metavar="CHANNEL=COLUMN",
            help="theta_e=COLUMN or theta_mech=COLUMN: true angle in radians; position=COLUMN: "
            "true position of a levitated body in metres; speed_mech=COLUMN: mechanical speed in "
            "rad/s, which tells `identify` the R_R of an induction machine.",
        ),
    ],
}

#: Options that may be followed by several NAME=VALUE.
REPEATED = (*("--column", "--columns", "--scale", "--offset", "--truth", "--prior", "--priors"),)


def reads_logs(*without: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command the options of :data:`LAYOUT`, less those named, as its argument `layout`."""
    names = [name for name in LAYOUT if name not in without]

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        own = inspect.signature(command, eval_str=True)
        kept = [p for p in own.parameters.values() if p.name != "layout"]
        added = [
            inspect.Parameter(
                name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=LAYOUT[name]
            )
            for name in names
        ]
        kept = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in kept]

        @wraps(command)
        def wrapper(**given: Any) -> None:
            taken = {name: given.pop(name) for name in names}
            command(**given, layout=layout_of(taken))

        wrapper.__signature__ = own.replace(parameters=[*kept, *added])  # type: ignore[attr-defined]
        wrapper.__annotations__ = {p.name: p.annotation for p in [*kept, *added]}
        return wrapper

    return decorate


def layout_of(options: dict[str, Any]) -> dict[str, Any]:
    """The options that are given, as arguments of :func:`fluxobs.read_log`."""
    layout = {name: value for name, value in options.items() if value is not None}
    for name in ("columns", "truth"):
        if name in layout:
            layout[name] = pairs("column" if name == "columns" else name, layout[name])
    for name in ("scale", "offset"):
        if name in layout:
            layout[name] = numbers(name, layout[name])
    return layout


def pairs(option: str, given: Pairs) -> dict[str, str]:
    """Names and values from NAME=VALUE."""
    out = {}
    for pair in given or []:
        name, equals, value = pair.partition("=")
        if not (name and equals and value):
            raise RecordError(f"--{option}: expected NAME=VALUE, got {pair!r}")
        out[name.strip()] = value.strip()
    return out


def numbers(option: str, given: Pairs) -> dict[str, float]:
    """Names and numbers from NAME=VALUE."""
    out = {}
    for name, value in pairs(option, given).items():
        try:
            out[name] = float(value)
        except ValueError:
            raise RecordError(f"--{option} {name}={value}: {value!r} is not a number") from None
    return out


def refuse_input_as_output(out: Path, *inputs: Path | None) -> None:
    """Raise FluxobsError if `out` is one of the input files."""
    for source in inputs:
        if source is not None and source.exists() and out.exists() and out.samefile(source):
            raise FluxobsError(f"{out}: --out is one of the inputs; give another name")
