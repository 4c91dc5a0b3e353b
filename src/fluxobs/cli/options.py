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
    typer.Argument(
        metavar="LOG",
        help="Text as instruments write it (CSV, TXT, LVM, …, also .gz), Parquet, Arrow, npz, npy, "
        "JSON, HDF5, MAT, MDF4, TDMS, ULog, Excel. `fluxobs channels LOG` shows what it holds.",
    ),
]
ReportOption = Annotated[
    Path | None, typer.Option(help="Report: .html; or a picture: .png, .pdf, .svg.")
]
ForceOption = Annotated[bool, typer.Option("--force", help="Overwrite files that exist.")]
QuietOption = Annotated[
    bool, typer.Option("--quiet", "-q", help="Print nothing but warnings and errors.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON, for scripts.")]
SaveRecordOption = Annotated[
    Path | None,
    typer.Option(help="Record file to write, .toml: how the log was read, guesses included."),
]
DriveOption = Annotated[
    str | None,
    typer.Option(
        help="Of many: regular expression that finds the drive in a log's path; default its folder."
    ),
]
WorkersOption = Annotated[
    int | None, typer.Option(min=1, help="Processes; default one per processor.")
]
SchedulerOption = Annotated[
    str,
    typer.Option(
        help="local: Dask on this machine if it is installed, else a pool of processes; pool; or "
        "the address of a Dask scheduler, tcp://host:8786."
    ),
]
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
    "preset": Annotated[
        str | None,
        typer.Option(help="Record of a known tool; `fluxobs presets` lists them."),
    ],
    "frame": Annotated[
        str | None,
        typer.Option(
            help="alphabeta (u_alpha u_beta i_alpha i_beta), abc (u_a … i_c; or two currents), "
            "line (two of u_ab u_bc u_ca), duty (d_a d_b d_c udc), dq (u_d u_q i_d i_q theta_e; a "
            "voltage is turned by the angle in the middle of the interval it acts over), ports "
            "(u_1 u_2 i_1 i_2: maglev-2dof). Default: the first of these that the columns fill."
        ),
    ],
    "currents": Annotated[
        str | None,
        typer.Option(help="Frame of the currents, if another: alphabeta, abc or dq."),
    ],
    "sample_time": Annotated[
        float | None,
        typer.Option(help="Seconds; needed if neither a column nor the header says it."),
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
    "unit": Annotated[
        Pairs,
        typer.Option(
            "--unit",
            "--units",
            metavar="CHANNEL=UNIT",
            help="As i_a=mA theta=deg speed=rpm t=ms; i, u, duty, theta, speed stand for all of "
            "these. counts:4096 (of a turn, of full duty), ticks:170e6 (t, Hz), q8 (fixed point). "
            "Default: the file's unit, or that in the name.",
        ),
    ],
    "adc": Annotated[
        Pairs,
        typer.Option(
            metavar="CHANNEL=BITS,RANGE,ZERO",
            help="Raw counts: i=12,100,2048 are 12 bits that span 100 A, zero at 2048.",
        ),
    ],
    "scale": Annotated[
        Pairs,
        typer.Option(
            metavar="CHANNEL=NUMBER",
            help="What turns a column into SI, in place of a unit: the channel is scale · column + "
            "offset. -1 turns a sign.",
        ),
    ],
    "offset": Annotated[
        Pairs,
        typer.Option(
            metavar="CHANNEL=NUMBER", help="What is added to a channel after that, in SI."
        ),
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
            help="What the estimate is scored by: theta_e or theta_mech=COLUMN: true angle; "
            "sincos=SINE,COSINE; hall=A,B,C; speed_mech or speed_e=COLUMN (tells `identify` the "
            "R_R of an induction machine); position=COLUMN of a levitated body. none: nothing, "
            "even if a column looks like an angle.",
        ),
    ],
    "fit_truth": Annotated[
        bool | None,
        typer.Option(
            "--fit-truth/--truth-as-given",
            help="Fit zero, direction, pole pairs, delay and eccentricity of the truth to the "
            "estimate, and report them apart (default).",
        ),
    ],
    "header": Annotated[
        str | None,
        typer.Option(metavar="NAMES", help='Names for a file without: "t,u_a,u_b,u_c,i_a,i_b".'),
    ],
    "join": Annotated[
        list[str] | None,
        typer.Option(metavar="FILE", help="A further file of the same run; may be repeated."),
    ],
    "align": Annotated[
        str | None,
        typer.Option(
            help="How the times of joined files belong together: time (stamps; default), index "
            "(row by row), auto (by what both saw)."
        ),
    ],
}

#: Options that may be followed by several NAME=VALUE.
REPEATED = (
    *("--column", "--columns", "--unit", "--units", "--adc", "--scale", "--offset", "--truth"),
    *("--prior", "--priors", "--set"),
)


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
    if layout.get("truth") == ["none"]:
        layout["truth"] = ["none=-"]
    for name in ("columns", "truth", "unit", "adc"):
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
            raise FluxobsError(f"{out}: this is one of the inputs; give another name")
