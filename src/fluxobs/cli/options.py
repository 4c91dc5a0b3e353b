"""Options that several commands share, named like the arguments of the library.

:data:`LAYOUT` defines the options that describe how to read a log. The decorator :func:`reads_logs`
adds them to a command and passes their values as one mapping, ``layout``.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import FluxobsError, RecordError, UsageError

Pairs = list[str] | None


def _lag(text: str) -> float | str:
    try:
        return "auto" if text == "auto" else float(text)
    except ValueError:
        raise typer.BadParameter(f"{text!r} is neither a number of samples nor auto") from None


def _no_machine() -> Path:
    raise UsageError(
        "give --machine: a machine file, or a name that `fluxobs machines` lists. `fluxobs machine "
        "new --out motor.toml` writes a machine file from the values of a data sheet"
    )


MachineOption = Annotated[
    Path,
    typer.Option(
        default_factory=_no_machine,
        show_default=False,
        help="Required. Machine file (TOML: kind, R_s, … in SI units; `fluxobs machine new` writes "
        "one from a data sheet), or a name from `fluxobs machines`.",
    ),
]
LogArgument = Annotated[
    Path,
    typer.Argument(
        metavar="LOG",
        help="Log file: text (CSV, TXT, LVM, …, also .gz), Parquet, Arrow, npz, npy, JSON, HDF5, "
        "MAT, MDF4, TDMS, ULog or Excel. `fluxobs channels LOG` lists its columns.",
    ),
]
ReportOption = Annotated[
    Path | None, typer.Option(help="Report to write: .html, or a picture: .png, .pdf, .svg.")
]
ForceOption = Annotated[bool, typer.Option("--force", help="Overwrite existing files.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print only warnings and errors.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON, for scripts.")]
SaveRecordOption = Annotated[
    Path | None,
    typer.Option(
        help="Record file to write, .toml: how this log was read, including guessed settings."
    ),
]
DriveOption = Annotated[
    str | None,
    typer.Option(
        help="With many logs: regular expression that finds the drive's name in a log's path. "
        "Default: the log's folder."
    ),
]
WorkersOption = Annotated[
    int | None, typer.Option(min=1, help="Number of processes; default one per processor core.")
]
SchedulerOption = Annotated[
    str,
    typer.Option(
        help="local: Dask on this computer if installed, else a process pool; pool: a process "
        "pool; tcp://HOST:8786: a Dask scheduler at this address."
    ),
]
PriorOption = Annotated[
    Pairs,
    typer.Option(
        "--prior",
        "--priors",
        metavar="NAME=NUMBER",
        help="Standard deviations of the machine file's values: resistance=OHM, inverter=VOLT, "
        "psi_f=WB, asymmetry=NUMBER. Default: resistance half of R_s; inverter a quarter of "
        "R_s times the rated current, or more at high voltage; psi_f a quarter of its value. "
        "`estimate` without --causal also accepts lag (samples), offset (A), current_gain, "
        "voltage_gain, link_sag, iron_loss, L_d, L_q, saturation, harmonics, R_R, L_M, "
        "voltage_scale, current_scale (shares), tilt (rad).",
    ),
]

#: Options of every command that reads a log: argument name → annotation.
LAYOUT: dict[str, Any] = {
    "record": Annotated[
        Path | None,
        typer.Option(help="Record file (TOML: frame, lag, columns, …); options override it."),
    ],
    "preset": Annotated[
        str | None,
        typer.Option(help="Layout of a known tool's logs; `fluxobs presets` lists the names."),
    ],
    "frame": Annotated[
        str | None,
        typer.Option(
            help="Frame and channels: alphabeta (u_alpha u_beta i_alpha i_beta), abc (u_a … i_c, "
            "or only two currents), line (two of u_ab u_bc u_ca), duty (d_a d_b d_c udc), dq "
            "(u_d u_q i_d i_q theta_e; the voltage is rotated by the angle in the middle of "
            "its interval), ports (u_1 u_2 i_1 i_2 of maglev-2dof). Default: the first frame "
            "whose channels the log has."
        ),
    ],
    "currents": Annotated[
        str | None,
        typer.Option(
            help="Frame of the currents if it differs from --frame: alphabeta, abc or dq."
        ),
    ],
    "sample_time": Annotated[
        float | None,
        typer.Option(
            help="Sample time in seconds; needed if the log has neither a time column nor a rate."
        ),
    ],
    "lag": Annotated[
        Any,
        typer.Option(
            parser=_lag,
            metavar="SAMPLES|auto",
            help="When the voltage of a row acts. -1: from the next row on, as in most drives; 0: "
            "from its row to the next row; +1: up to its row. Fractions are allowed. auto "
            "(default): `estimate`, `identify`, `check` and `compare` learn it from the log; other "
            "commands assume 0.",
        ),
    ],
    "held": Annotated[
        bool | None,
        typer.Option(
            "--held/--not-held",
            help="Treat each voltage as constant over its sample, like an inverter's mean voltage. "
            "Default: yes if R h/L exceeds 0.15, else no.",
        ),
    ],
    "columns": Annotated[
        Pairs,
        typer.Option(
            "--column",
            "--columns",
            metavar="CHANNEL=COLUMN",
            help="Column of a channel. udc=540 sets a constant DC-link voltage; t=- ignores the "
            "column t.",
        ),
    ],
    "unit": Annotated[
        Pairs,
        typer.Option(
            "--unit",
            "--units",
            metavar="CHANNEL=UNIT",
            help="For example i_a=mA theta=deg speed=rpm t=ms; i, u, duty, theta and speed each "
            "mean all channels of that quantity. counts:4096 (per turn, or at full duty), "
            "ticks:170e6 (timer of t, Hz), q8 (fixed point). Default: the unit in the file or "
            "in the column's name.",
        ),
    ],
    "adc": Annotated[
        Pairs,
        typer.Option(
            metavar="CHANNEL=BITS,RANGE,ZERO",
            help="Raw converter counts: i=12,100,2048 means 12 bits, 100 A full range, zero at "
            "count 2048.",
        ),
    ],
    "scale": Annotated[
        Pairs,
        typer.Option(
            metavar="CHANNEL=NUMBER",
            help="Factor to SI units, instead of a unit: channel = scale · column + offset. -1 "
            "reverses the sign.",
        ),
    ],
    "offset": Annotated[
        Pairs,
        typer.Option(metavar="CHANNEL=NUMBER", help="Offset to add after scaling, in SI units."),
    ],
    "start": Annotated[
        float | None,
        typer.Option("--from", "--start", help="Skip rows before this time in seconds."),
    ],
    "stop": Annotated[
        float | None, typer.Option("--to", "--stop", help="Skip rows after this time in seconds.")
    ],
    "truth": Annotated[
        Pairs,
        typer.Option(
            metavar="CHANNEL=COLUMN",
            help="Reference that scores the estimate: theta_e=COLUMN or theta_mech=COLUMN (true "
            "angle); sincos=SINE,COSINE; hall=A,B,C; speed_mech=COLUMN or speed_e=COLUMN "
            "(lets `identify` find R_R of an induction machine); position=COLUMN of a "
            "levitated body; none: no reference, even if a column looks like an angle.",
        ),
    ],
    "fit_truth": Annotated[
        bool | None,
        typer.Option(
            "--fit-truth/--truth-as-given",
            help="Fit the reference's zero, direction, pole pairs, delay and eccentricity to the "
            "estimate and report them separately (default).",
        ),
    ],
    "header": Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help='Column names of a file without a header: "t,u_a,u_b,u_c,i_a,i_b".',
        ),
    ],
    "join": Annotated[
        list[str] | None,
        typer.Option(
            metavar="FILE", help="Another file of the same run; the option may be repeated."
        ),
    ],
    "align": Annotated[
        str | None,
        typer.Option(
            help="How to align joined files: time (time stamps; default), index (row by row), auto "
            "(by the signals common to the files)."
        ),
    ],
}

#: Options that accept several NAME=VALUE pairs.
REPEATED = (
    *("--column", "--columns", "--unit", "--units", "--adc", "--scale", "--offset", "--truth"),
    *("--prior", "--priors", "--set"),
)


def with_options(
    argument: str, table: dict[str, Any], convert: Callable[[dict[str, Any]], Any]
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Add the options of a table to a command, which gets them converted as one argument."""

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(command, eval_str=True)
        own_parameters = [p for p in signature.parameters.values() if p.name != argument]
        added_parameters = [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=kind)
            for name, kind in table.items()
        ]
        own_parameters = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in own_parameters]
        parameters = [*own_parameters, *added_parameters]

        @wraps(command)
        def wrapper(**arguments: Any) -> None:
            options = {name: arguments.pop(name) for name in table}
            command(**arguments, **{argument: convert(options)})

        wrapper.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        wrapper.__annotations__ = {p.name: p.annotation for p in parameters}
        return wrapper

    return decorate


def reads_logs(*without: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Add the options of :data:`LAYOUT`, except `without`, to a command as argument `layout`."""
    table = {name: kind for name, kind in LAYOUT.items() if name not in without}
    return with_options("layout", table, layout_of)


def layout_of(options: dict[str, Any]) -> dict[str, Any]:
    """Return the given options as arguments of :func:`fluxobs.read_log`."""
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


def pairs(option: str, arguments: Pairs) -> dict[str, str]:
    """Parse NAME=VALUE pairs; raise RecordError if one is malformed."""
    values = {}
    for pair in arguments or []:
        name, equals, value = pair.partition("=")
        if not (name and equals and value):
            raise RecordError(f"--{option}: expected NAME=VALUE, got {pair!r}")
        values[name.strip()] = value.strip()
    return values


def numbers(option: str, arguments: Pairs) -> dict[str, float]:
    """Parse NAME=NUMBER pairs; raise RecordError if one is malformed."""
    values = {}
    for name, value in pairs(option, arguments).items():
        try:
            values[name] = float(value)
        except ValueError:
            raise RecordError(f"--{option} {name}={value}: {value!r} is not a number") from None
    return values


def refuse_input_as_output(out: Path, *inputs: Path | None) -> None:
    """Raise FluxobsError if `out` is one of the input files."""
    for source in inputs:
        if source is not None and source.exists() and out.exists() and out.samefile(source):
            raise FluxobsError(f"{out}: this is one of the inputs; choose another name")
