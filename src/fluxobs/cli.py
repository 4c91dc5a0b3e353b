"""Command line. Heavy modules are imported where they are used: start-up time counts."""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import sys
import textwrap
import time
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .errors import FluxobsError, RecordError

if TYPE_CHECKING:
    from .estimate import Result
    from .logs import Log
    from .machines import Machine, RotatingMachine

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Magnetic flux, rotor position, speed and sensor drift from a drive's currents and "
    "voltages, both biased.",
)

#: Options that may be followed by several NAME=VALUE.
PAIRS = ("--column", "--scale", "--offset", "--truth", "--prior")

Pairs = list[str] | None

#: How a log is laid out: options of every command that reads one.
MachineOption = Annotated[
    Path, typer.Option(help="TOML with kind, R_s, … in SI; or a name from `fluxobs machines`.")
]
RecordOption = Annotated[
    Path | None, typer.Option(help="TOML with frame, lag, columns, …; options override it.")
]
FrameOption = Annotated[
    str | None,
    typer.Option(
        help="alphabeta (u_alpha u_beta i_alpha i_beta), abc (u_a … i_c; or two currents), "
        "line (u_ab u_bc), duty (d_a d_b d_c udc), dq (u_d u_q i_d i_q theta_e; a voltage is "
        "turned by the angle in the middle of the interval it acts over), ports (u_1 u_2 "
        "i_1 i_2: maglev-2dof). Default alphabeta, or ports."
    ),
]
SampleTimeOption = Annotated[
    float | None, typer.Option(help="Seconds; needed where there is no column t.")
]
LagOption = Annotated[
    float | None,
    typer.Option(
        help="Samples. 0 (default): a row's voltage acts from that row to the next; -1: one "
        "sample later (usual computation delay); +1: one earlier; fractions allowed."
    ),
]
ColumnOption = Annotated[
    Pairs,
    typer.Option(
        help="CHANNEL=COLUMN; udc=540 sets a constant DC-link voltage, t=- passes over a column t."
    ),
]
ScaleOption = Annotated[Pairs, typer.Option(help="CHANNEL=NUMBER: scale · column + offset.")]
OffsetOption = Annotated[Pairs, typer.Option(help="CHANNEL=NUMBER: scale · column + offset.")]
FromOption = Annotated[
    float | None, typer.Option("--from", help="Seconds; only rows from this time on.")
]
ToOption = Annotated[float | None, typer.Option("--to", help="Seconds; only rows to this time.")]
TruthOption = Annotated[
    Pairs,
    typer.Option(
        help="theta_e=COLUMN or theta_mech=COLUMN: a true angle in radians; position=COLUMN: "
        "of a levitated body, in metres."
    ),
]
PriorOption = Annotated[
    Pairs,
    typer.Option(
        help="resistance=OHM, inverter=VOLT, psi_f=WB: standard deviations of what the machine "
        "file says. Default: a quarter of R_s, of R_s times the rated current, and of psi_f."
    ),
]


@app.command()
def estimate(
    log: Annotated[
        Path, typer.Argument(help="CSV (any delimiter), Parquet or npz; a column a channel.")
    ],
    machine: MachineOption,
    out: Annotated[Path, typer.Option(help="Where the estimates go, .parquet or .csv.")],
    record: RecordOption = None,
    frame: FrameOption = None,
    sample_time: SampleTimeOption = None,
    lag: LagOption = None,
    column: ColumnOption = None,
    scale: ScaleOption = None,
    offset: OffsetOption = None,
    start: FromOption = None,
    stop: ToOption = None,
    truth: TruthOption = None,
    report: Annotated[Path | None, typer.Option(help="Picture: .png, .pdf or .svg.")] = None,
    memory: Annotated[
        float | None,
        typer.Option(
            help="Seconds; memory of the least squares. The default, 0.03 (maglev-2dof: 0.15), "
            "serves most machines."
        ),
    ] = None,
    unknowns: Annotated[
        str,
        typer.Option(
            help="What is constant, or slow, and not known: drift (default); drift,resistance, "
            "drift,inverter or drift,resistance,inverter: errors of R_s, and of the inverter (dead "
            "time and device drops); current-bias, or drift,current-bias: the slower, general "
            "least squares, 0.25 ms a row; a current bias alone assumes that the voltage has no "
            "offset."
        ),
    ] = "drift",
    prior: PriorOption = None,
) -> None:
    """Estimate flux, position, speed and drift of a recorded log.

    Writes a row a sample, in SI units and electrical radians: t, flux_alpha, flux_beta, psi_f,
    theta_e (straight from the flux), theta_e_tracked, speed_e, drift_alpha, drift_beta,
    theta_e_std, valid; and theta_e_error where a truth is given. Prints a summary.

    With resistance or inverter among the unknowns also: resistance, inverter_voltage, psi_f of the
    magnet, drift, each with its standard deviation, and the other angle while two are in question.
    For a maglev-2dof, and with a current bias: flux, position or theta_e, drift, current_bias with
    their standard deviations, noise_share, valid.
    """
    from .machines import RotatingMachine, read_machine
    from .reference_estimate import check_truth
    from .unknowns import adapts, check_adapted, read_unknowns

    wanted, priors = read_unknowns(unknowns), _numbers("prior", prior)
    given = read_machine(machine)
    check_adapted(given, wanted, priors)
    for source in (machine, record):
        if source is not None and source.exists() and out.exists() and out.samefile(source):
            raise FluxobsError(f"{out}: --out is one of the inputs; give another name")
    opened = _open(
        log, given, record, frame, sample_time, lag, column, scale, offset, start, stop, truth
    )
    check_truth(opened, given)
    if isinstance(given, RotatingMachine) and (wanted == ("drift",) or adapts(wanted)):
        if not adapts(wanted):  # the adaptive observer knows of the inverter itself
            opened = _less_inverter(opened, given)
        _run(opened, given, str(machine), out, report, memory, wanted, priors)
    else:
        opened = _less_inverter(opened, given)
        _run_reference(opened, given, wanted, out, report, memory)


@app.command()
def identify(
    log: Annotated[
        Path, typer.Argument(help="CSV (any delimiter), Parquet or npz; a column a channel.")
    ],
    machine: MachineOption,
    out: Annotated[Path, typer.Option(help="Machine file to be written, .toml.")],
    free: Annotated[
        str | None,
        typer.Option(
            help="What is fitted, of R_s, L_s (or L_d, L_q), psi_f, inverter, lag. Default "
            "R_s,psi_f,inverter, as far as the machine has them; the rest stays as given."
        ),
    ] = None,
    record: RecordOption = None,
    frame: FrameOption = None,
    sample_time: SampleTimeOption = None,
    lag: LagOption = None,
    column: ColumnOption = None,
    scale: ScaleOption = None,
    offset: OffsetOption = None,
    start: FromOption = None,
    stop: ToOption = None,
    report: Annotated[
        Path | None, typer.Option(help="Picture of the residual: .png, .pdf or .svg.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite --out.")] = False,
) -> None:
    """Fit the machine's parameters and the inverter's error to a whole log.

    Prints each parameter with its standard deviation, and says which ones the log cannot tell:
    they are held as given. The machine file that it writes serves `fluxobs estimate`, which takes
    the inverter's error (inverter_voltage) off the commanded voltages. A lag is no part of it.
    Where the log tells nothing, nothing is written (exit code 2).
    """
    from .identification import identify as run
    from .identification.identify import read_free
    from .identification.report import draw, lines, toml
    from .machines import RotatingMachine, read_machine
    from .writing import write_text

    given = read_machine(machine)
    if not isinstance(given, RotatingMachine):
        raise FluxobsError(f"{given.kind}: only machines that turn can be identified")
    wanted = read_free(free, given)
    _check_machine_out(out, force, log, record)
    if report is not None:
        from .plots import check_path

        check_path(report)
    opened = _open(
        log, given, record, frame, sample_time, lag, column, scale, offset, start, stop, None
    )
    found = run(opened, given, wanted)
    for line in lines(found):
        _echo(line)
    write_text(out, toml(found, log))
    typer.echo(f"Written: {out}")
    if report is not None:
        draw(found, report)
        typer.echo(f"Written: {report}")


@app.command()
def check(
    log: Annotated[
        Path, typer.Argument(help="CSV (any delimiter), Parquet or npz; a column a channel.")
    ],
    machine: MachineOption,
    record: RecordOption = None,
    frame: FrameOption = None,
    sample_time: SampleTimeOption = None,
    lag: LagOption = None,
    column: ColumnOption = None,
    scale: ScaleOption = None,
    offset: OffsetOption = None,
    start: FromOption = None,
    stop: ToOption = None,
) -> None:
    """Is a log what you think? Tries the usual mistakes.

    Sign of the current, phase order, lag of the voltage from two samples earlier to two later, in
    all combinations; scales (line to line √3, rms √2, power-invariant √1.5) and R_s per phase or
    line to line, by the resistance and the magnet flux that fit. Says which fits best, how surely,
    and what the log cannot tell. Exit code 1: something else fits better than what was given.
    """
    from .identification.check import check as run
    from .identification.check import lines
    from .machines import RotatingMachine, read_machine

    given = read_machine(machine)
    if not isinstance(given, RotatingMachine):
        raise FluxobsError(f"{given.kind}: only logs of machines that turn can be checked")
    opened = _open(
        log, given, record, frame, sample_time, lag, column, scale, offset, start, stop, None
    )
    found = run(opened, given)
    for line in lines(found):
        _echo(line)
    if not found.sound:
        raise typer.Exit(1)


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for the results; made if missing.")] = Path(
        "fluxobs-demo"
    ),
) -> None:
    """Run the main job on a log that comes with the package."""
    from importlib import resources

    from .demo import MACHINE, log_file
    from .formats import open_table
    from .layout import Layout
    from .logs import open_log
    from .machines import RotatingMachine, example

    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FluxobsError(f"{out}: cannot be made: {error.strerror}") from None
    machine = example(MACHINE)
    assert isinstance(machine, RotatingMachine)
    with resources.as_file(log_file()) as path:
        log = open_log(open_table(path), Layout(truth={"theta_e": "theta_e"}), machine.n_p)
        _run(log, machine, MACHINE, out / "estimates.parquet", out / "report.png", None)


@app.command()
def reproduce(
    out: Annotated[Path, typer.Option(help="Folder for figures and report; made if missing.")] = (
        Path("fluxobs-paper")
    ),
    quick: Annotated[
        bool, typer.Option("--quick", help="One scenario, 30 s of it: a quarter of the time.")
    ] = False,
) -> None:
    """Reproduce Section V of the paper, as printed, corrected and beyond.

    Writes report.md, numbers.json and figures (PNG, and SVG unless --quick).

    Needs the extra "design" (JAX).
    """
    # Most of the time is compilation; must be said before JAX is loaded.
    os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0")
    from .paper.reproduce import reproduce as run

    run(out, quick, typer.echo)
    typer.echo(f"Written: {out / 'report.md'}, numbers.json and figures")


@app.command()
def compare(
    records: Annotated[
        list[str],
        typer.Argument(
            metavar="LOG|SCENARIO …",
            help="Logs with a true angle (--truth), or scenarios by name; `list` lists them, "
            "`all` takes all.",
        ),
    ],
    machine: Annotated[
        Path | None,
        typer.Option(
            help="TOML or a name from `fluxobs machines`. Scenarios run on the shipped machines "
            "that turn; default pmsm-2kw2."
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for scores and pictures; made if missing.")] = (
        Path("fluxobs-compare")
    ),
    seed: Annotated[int, typer.Option(min=0, help="Of a scenario's sensor noise.")] = 0,
    settle: Annotated[
        float, typer.Option(help="Seconds of a log that are not scored, while observers settle.")
    ] = 0.2,
    record: RecordOption = None,
    frame: FrameOption = None,
    sample_time: SampleTimeOption = None,
    lag: LagOption = None,
    column: ColumnOption = None,
    scale: ScaleOption = None,
    offset: OffsetOption = None,
    start: FromOption = None,
    stop: ToOption = None,
    truth: TruthOption = None,
) -> None:
    """Run a log or a scenario through every known observer, and score them.

    Each observer runs with usual gains, and with the best of a grid for this very record.

    Writes scores.csv and a picture a record, and summary.png for several. Needs the extra "design"
    (JAX).
    """
    from .comparison.scenarios import SCENARIOS
    from .machines import RotatingMachine, read_machine

    if "list" in records:
        width = max(len(name) for name in SCENARIOS)
        for scenario in SCENARIOS.values():
            typer.echo(f"{scenario.name:{width}}  {scenario.about}")
        return
    names = [n for r in records for n in (SCENARIOS if r == "all" else [r])]
    logs = [name for name in names if name not in SCENARIOS]
    for name in logs:
        if not Path(name).exists():
            raise FluxobsError(
                f"{name!r} is neither a file nor a scenario; `fluxobs compare list` lists these"
            )
    if logs and machine is None:
        raise FluxobsError(f"--machine is needed for a log ({logs[0]})")
    from .comparison import report
    from .comparison.compare import compare_log, compare_scenario

    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FluxobsError(f"{out}: cannot be made: {error.strerror}") from None
    comparisons = []
    for name in names:
        if name in SCENARIOS:
            drive = str(machine) if machine is not None else "pmsm-2kw2"
            found = compare_scenario(SCENARIOS[name], drive, seed)
        else:
            assert machine is not None
            given = read_machine(machine)
            if not isinstance(given, RotatingMachine):
                raise FluxobsError(f"{given.kind}: only machines that turn can be compared on")
            opened = _open(
                Path(name),
                given,
                record,
                frame,
                sample_time,
                lag,
                column,
                scale,
                offset,
                start,
                stop,
                truth,
            )
            found = compare_log(_less_inverter(opened, given), given, settle)
        comparisons.append(found)
        _print_table(report.table(found))
        _echo(report.verdict(found))
        picture = out / f"{Path(found.title).stem}.png"
        report.draw(found, picture)
        report.write_csv(comparisons, out / "scores.csv")
    if len(comparisons) > 1:
        report.draw_summary(comparisons, out / "summary.png")
    pictures = "a picture a record" + (", summary.png" if len(comparisons) > 1 else "")
    typer.echo(f"Written: {out / 'scores.csv'}, {pictures}")


@app.command()
def export(
    machine: MachineOption,
    sample_time: Annotated[
        float, typer.Option(help="Seconds; period of the current-control interrupt.")
    ],
    out: Annotated[Path, typer.Option(help="Folder to be made.")],
    unknowns: Annotated[
        str,
        typer.Option(
            help="What is constant, or slow, and not known: drift; with resistance, inverter or "
            "both it is the adaptive observer, which starts within a fraction of a turn."
        ),
    ] = "drift",
    memory: Annotated[
        float | None, typer.Option(help="Seconds; memory of the least squares. Default 0.03.")
    ] = None,
    current_noise: Annotated[
        float | None,
        typer.Option(
            help="Ampere, standard deviation of a component; default 0.2 % of the rated current. "
            "`fluxobs estimate` prints what it took for a log."
        ),
    ] = None,
    drift_prior: Annotated[
        float | None, typer.Option(help="Volt; largest plausible drift. Default from the machine.")
    ] = None,
    prior: PriorOption = None,
    update_every: Annotated[
        int,
        typer.Option(
            help="Interrupts from one step of the observer to the next: where time is short, the "
            "example then gathers volt-seconds in between."
        ),
    ] = 1,
    prefix: Annotated[
        str, typer.Option(help="Of the generated names, so that two machines fit one firmware.")
    ] = "motor",
    force: Annotated[bool, typer.Option("--force", help="Overwrite an earlier export.")] = False,
) -> None:
    """Write the observer for one machine as C99 that compiles into its firmware.

    The folder holds the sources, a header with the parameters, an example interrupt, and test
    vectors with a host test: `make test` in it replays them. It does sample by sample what
    `fluxobs estimate` does.
    """
    from .deployment import export as write
    from .machines import read_machine
    from .unknowns import read_unknowns

    done = write(
        read_machine(machine),
        sample_time,
        out,
        memory=memory,
        unknowns=read_unknowns(unknowns),
        current_noise=current_noise,
        drift_prior=drift_prior,
        priors=_numbers("prior", prior),
        update_every=update_every,
        prefix=prefix,
        force=force,
    )
    folder = shlex.quote(str(done.folder))
    typer.echo(f"Written: {folder}, content {done.content}. Try: make -C {folder} test")


@app.command()
def machines() -> None:
    """List the machines that come with the package; any name serves as --machine."""
    from .machines import example, example_names, example_text

    for name in example_names():
        machine = example(name)
        title = example_text(name).splitlines()[0].removeprefix("# ")
        values = ", ".join(
            f"{key} = {value:g}"
            for key, value in machine.model_dump(by_alias=True).items()
            if value is not None
        )
        typer.echo(f"{name}\n    {machine.kind}: {values}\n    {title}")
    typer.echo("\nSI units; R and L per phase (star), psi_f and rated_current peak values.")


def _open(
    log: Path,
    machine: Machine,
    record: Path | None,
    frame: str | None,
    sample_time: float | None,
    lag: float | None,
    column: Pairs,
    scale: Pairs,
    offset: Pairs,
    start: float | None,
    stop: float | None,
    truth: Pairs,
) -> Log:
    """The log as its options, and the record file under them, say."""
    from .formats import open_table
    from .layout import layout_from, read_layout
    from .logs import open_log

    fields: dict[str, Any] = read_layout(record) if record else {}
    for name, value in (("frame", frame), ("sample_time", sample_time), ("lag", lag)):
        if value is not None:
            fields[name] = value
    fields["columns"] = fields.get("columns", {}) | _pairs("column", column)
    for name, pairs in (("scale", scale), ("offset", offset)):
        fields[name] = fields.get(name, {}) | _numbers(name, pairs)
    if truth:
        fields["truth"] = _pairs("truth", truth)
    fields.setdefault("frame", machine.frame)
    if (fields["frame"] == "ports") != (machine.frame == "ports"):
        raise FluxobsError(
            f"frame {fields['frame']!r} does not fit kind {machine.kind}; "
            f"leave it at {machine.frame!r}"
        )
    table = open_table(log)
    constant = fields["columns"].get("udc", "")
    if constant in table.columns:
        fields.pop("udc", None)
    elif _is_number(constant):
        del fields["columns"]["udc"]
        fields["udc"] = float(constant)
    layout = layout_from(fields, "options")
    return open_log(table, layout, getattr(machine, "n_p", 1), start, stop)


def _less_inverter(log: Log, machine: Machine) -> Log:
    """The log less what the machine file says that the inverter loses."""
    from dataclasses import replace

    return replace(log, inverter=getattr(machine, "inverter", None))


def _check_machine_out(out: Path, force: bool, *inputs: Path | None) -> None:
    """Refuses early what could not, or must not, be written at the end."""
    from .writing import check_place

    if out.suffix != ".toml":
        raise FluxobsError(f"{out}: --out must end in .toml")
    check_place(out)
    if out.exists():
        for source in inputs:
            if source is not None and source.exists() and out.samefile(source):
                raise FluxobsError(f"{out}: --out is one of the inputs; give another name")
        if not force:
            raise FluxobsError(f"{out}: exists; give another name, or --force to overwrite it")


def _check(log: Log, report: Path | None, memory: float | None) -> None:
    if memory is not None and not memory >= 10 * log.sample_time:
        raise FluxobsError(
            f"--memory {memory:g} s is too short: at least ten samples, {10 * log.sample_time:g} s"
        )
    if report is not None:
        from .plots import check_path

        check_path(report)


def _run_reference(
    log: Log,
    machine: Machine,
    unknowns: tuple[str, ...],
    out: Path,
    report: Path | None,
    memory: float | None,
) -> None:
    from . import reference_estimate

    _check(log, report, memory)
    with _Progress(len(log)) as progress:
        chosen: Any = unknowns
        result = reference_estimate.estimate(log, machine, chosen, out, memory, progress)
    _print_summary(*reference_estimate.summarise(result))
    typer.echo(f"Written: {out}")
    if report is not None:
        reference_estimate.report(result, report)
        typer.echo(f"Written: {report}")


def _run(
    log: Log,
    machine: RotatingMachine,
    source: str,
    out: Path,
    report: Path | None,
    memory: float | None,
    unknowns: tuple[str, ...] = ("drift",),
    priors: dict[str, float] | None = None,
) -> None:
    from .estimate import estimate as run
    from .observers.least_squares import MEMORY
    from .summary import summarise

    _check(log, report, memory)
    with _Progress(len(log)) as progress:
        memory = memory if memory is not None else MEMORY
        result = run(log, machine, out, memory, progress, unknowns, priors)
    summary = summarise(result)
    _print_summary(summary.paragraph, summary.warnings)
    typer.echo(f"Written: {out}")
    if report is not None:
        from .plots import report as draw

        draw(result, report)
        typer.echo(f"Written: {report}")
    _advise_export(result, source, unknowns, priors or {})


def _advise_export(
    result: Result, source: str, unknowns: tuple[str, ...], priors: dict[str, float]
) -> None:
    """How the same observer gets into firmware."""
    o, machine = result.observer, result.machine
    if not machine.rated_current or not machine.flux_base(getattr(machine, "psi_f", None), 1.0):
        lacking = {"psi_f": o.flux_base, "rated_current": result.scales.current}
        values = [
            f"{k} ({v:.3g} here)" for k, v in lacking.items() if getattr(machine, k, 0) is None
        ]
        typer.echo(f"For an export as firmware the machine file needs {' and '.join(values)}.")
    elif machine.inverter is not None and result.adaptive is None:
        typer.echo(
            "In firmware the observer for the drift leaves the inverter to the drive: compensate "
            "it there, or export with --unknowns drift,inverter."
        )
    else:
        chosen = "" if result.adaptive is None else f" --unknowns {','.join(unknowns)}"
        chosen += "".join(f" --prior {name}={std!r}" for name, std in priors.items())
        typer.echo(
            f"The same in firmware: fluxobs export --machine {shlex.quote(source)}{chosen} "
            f"--sample-time {o.sample_time!r} --memory {o.memory!r} "
            f"--current-noise {o.current_noise!r} --drift-prior {o.drift_prior!r} --out FOLDER"
        )


def _print_summary(paragraph: str, warnings: list[str]) -> None:
    _echo(paragraph)
    for warning in warnings:
        _echo(f"Warning: {warning}")


def _echo(text: str) -> None:
    """Wrapped for a terminal, in one line for a pipe."""
    if sys.stdout.isatty():
        text = textwrap.fill(text, min(shutil.get_terminal_size().columns, 100))
    typer.echo(text)


def _print_table(table: Any) -> None:
    from rich.console import Console

    width = None if sys.stdout.isatty() else 110
    Console(width=width).print(table)


class _Progress:
    """A bar on standard error, once a run has taken a second."""

    def __init__(self, total: int) -> None:
        self.total, self.started = total, time.monotonic()
        self.bar: Any = None

    def __enter__(self) -> _Progress:
        return self

    def __call__(self, rows: int) -> None:
        if self.bar is None and time.monotonic() - self.started > 1 and rows < self.total:
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TaskProgressColumn, TimeRemainingColumn

            self.bar = Progress(
                BarColumn(),
                TaskProgressColumn(),
                TimeRemainingColumn(),
                console=Console(stderr=True),
                transient=True,
            )
            self.bar.start()
            self.task = self.bar.add_task("", total=self.total)
        if self.bar is not None:
            self.bar.update(self.task, completed=rows)

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            self.bar.stop()


def _pairs(option: str, pairs: Pairs) -> dict[str, str]:
    out = {}
    for pair in pairs or []:
        name, equals, value = pair.partition("=")
        if not (name and equals and value):
            raise RecordError(f"--{option}: expected NAME=VALUE, got {pair!r}")
        out[name.strip()] = value.strip()
    return out


def _numbers(option: str, pairs: Pairs) -> dict[str, float]:
    out = {}
    for name, value in _pairs(option, pairs).items():
        if not _is_number(value):
            raise RecordError(f"--{option} {name}={value}: {value!r} is not a number")
        out[name] = float(value)
    return out


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _spread(arguments: Iterable[str]) -> list[str]:
    """``--column a=b c=d`` means the same as ``--column a=b --column c=d``."""
    out: list[str] = []
    option = None
    for argument in arguments:
        if argument.startswith("--"):
            name, joined, _ = argument.partition("=")
            option = name if name in PAIRS else None
            taken = 1 if joined else 0
        elif option is not None and "=" in argument:
            if taken:
                out.append(option)
            taken += 1
        else:
            option = None
        out.append(argument)
    return out


def main() -> None:
    """Entry point; unusable input ends with a message and exit code 2."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    try:
        app(args=_spread(sys.argv[1:]), prog_name="fluxobs")
    except FluxobsError as error:
        typer.echo(f"Error: {error}", err=True)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
