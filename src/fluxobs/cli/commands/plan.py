"""`fluxobs machine plan` and `fluxobs plan-test`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ...core.validation import nearest
from ...errors import UsageError
from .. import show
from ..options import (
    ForceOption,
    JsonOption,
    Pairs,
    PriorOption,
    QuietOption,
    numbers,
    pairs,
    with_options,
)

if TYPE_CHECKING:
    from ...machines import RotatingMachine
    from ...planning.setup import Rating, Sensors


def _number(name: str, about: str) -> Any:
    return Annotated[float | None, typer.Option(f"--{name}", metavar="NUMBER", help=about)]


#: Options of a planned drive: argument → annotation. A shipped machine has ratings.
DRIVE: dict[str, Any] = {
    "speed": _number("speed", "Rated speed [rpm]."),
    "torque": _number("torque", "Rated torque [N m]; default 90 % of that of the rated current."),
    "inertia": _number("inertia", "Inertia with the load [kg m²]; default: usual."),
    "dc_link": _number("dc-link", "DC-link voltage [V]."),
    "sample_time": _number("sample-time", "Sample time [s]."),
    "noise": _number(
        "noise", "Noise of a current, standard deviation [A]; default 0.2 % of the rated current."
    ),
    "offset": _number(
        "offset", "Offset of a current, standard deviation [A]; default 1 % of the rated current."
    ),
    "gain": _number(
        "gain", "Standard deviation of a phase's gain against the others; default 0.01."
    ),
    "bits": _number("bits", "Bits of the A/D converter; default 12."),
    "range": _number(
        "range", "Largest current of the A/D converter [A]; default 2.5 times the rated current."
    ),
    "dead_time": _number("dead-time", "Uncompensated dead time [s]; default 1 % of a sample."),
    "drop": _number("drop", "Uncompensated drop of a switch [V]; default 0.2 % of the DC link."),
}
SENSORS = ("noise", "offset", "gain", "bits", "range", "dead_time", "drop")


def _setup(machine: str, drive: dict[str, Any]) -> tuple[RotatingMachine, Rating, Sensors]:
    from ...machines import as_machine, rotating
    from ...planning.setup import Sensors, rating_of
    from ...presentation.summary import RPM

    model = rotating(as_machine(machine), "a plan")
    speed = drive["speed"]
    rated = rating_of(
        model,
        machine,
        speed_e=None if speed is None else speed / RPM * model.n_p,
        torque=drive["torque"],
        J=drive["inertia"],
        dc_link=drive["dc_link"],
        sample_time=drive["sample_time"],
    )
    assert model.rated_current is not None
    sensors = Sensors.usual(model.rated_current, rated, **{name: drive[name] for name in SENSORS})
    return model, rated, sensors


MachineArgument = Annotated[
    str, typer.Argument(metavar="MACHINE", help="Machine file, or name of a shipped machine.")
]


@with_options("drive", DRIVE, dict)
def plan(
    machine: MachineArgument,
    drive: dict[str, Any],
    out: Annotated[
        Path | None, typer.Option(help="Picture of the plan: .png, .svg or .pdf.")
    ] = None,
    force: ForceOption = False,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Say what the adaptive observer of a drive will know, before the drive exists.

    Prints the standard deviation of the position over speed and load, the lowest valid speed, and
    what a better sensor or a better known machine would gain. State the accuracy of the machine
    file's values in the file (R_s_std, psi_f_std, L_s_std). Needs the extra "design" (JAX).

    Example: fluxobs machine plan motor.toml --speed 3000 --dc-link 48 --sample-time 1e-4
    """
    from ...campaigns.drives import planned_cell
    from ...core.output import check_new
    from ...core.plots import FORMATS
    from ...planning.limits import plan_drive
    from ...planning.report import plan_data, plan_text, write_plan

    if out is not None:
        check_new(out, FORMATS, force)  # an error now, not after the simulations
    _, rated, sensors = _setup(machine, drive)
    with show.Progress() as progress:
        planned = plan_drive(planned_cell(machine, rated), sensors, progress)
    if out is not None:
        write_plan(planned, out, force)
    if as_json:
        typer.echo(json.dumps(plan_data(planned)))
    elif not quiet:
        show.echo(plan_text(planned))


@with_options("drive", DRIVE, dict)
def plan_test(
    machine: MachineArgument,
    drive: dict[str, Any],
    out: Annotated[
        list[Path] | None,
        typer.Option(help="Set points: .csv for a bench, .h for firmware; may be repeated."),
    ] = None,
    want: Annotated[
        Pairs,
        typer.Option(
            metavar="NAME=STD",
            help="Standard deviation to reach: R_s=3% or R_s=0.01 (Ω), L_s, L_d, L_q, psi_f, "
            "inverter (V), J. Default: 5 % of resistance, inductances and magnet flux, and an "
            "inverter loss of a tenth of the rated resistive drop.",
        ),
    ] = None,
    no_load: Annotated[
        bool,
        typer.Option(
            "--no-load", help="There is no load machine: only currents along d are set points."
        ),
    ] = False,
    prior: PriorOption = None,
    force: ForceOption = False,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Plan the shortest test after which `fluxobs identify` knows the parameters well enough.

    A load machine holds the speed, the drive controls i_d and i_q with its encoder or observer.
    With J among the wanted parameters, speed ramps of the free shaft follow. Needs the extra
    "design" (JAX).

    Example: fluxobs plan-test motor.toml --speed 3000 --dc-link 48 --sample-time 1e-4 --want
    R_s=4% --want psi_f=4% --out test.csv
    """
    from ...core.output import check_new
    from ...planning.report import sequence_text, write_sequence
    from ...planning.sequence import Planner, usual_wants

    model, rated, sensors = _setup(machine, drive)
    for path in out or []:
        check_new(path, (".csv", ".h"), force)  # an error now, not after the search
    usual = usual_wants(model)
    wanted = _wanted(pairs("want", want), usual) if want else {n: w for n, (w, _) in usual.items()}
    planner = Planner(model, rated, sensors, wanted, numbers("prior", prior), not no_load)
    with show.Progress() as progress:
        sequence = planner.plan(progress)
    for path in out or []:
        write_sequence(sequence, path, force)
    if as_json:
        knots = [vars(knot) for knot in sequence.knots]
        typer.echo(
            json.dumps({"duration": sequence.duration, "stds": sequence.stds, "knots": knots})
        )
    elif not quiet:
        show.echo(sequence_text(sequence, wanted))
        names = ",".join(name for name in wanted if name != "J")
        if names:
            show.say(f"\nThen: `fluxobs identify LOG --machine {machine} --free {names}`.")
        if "J" in wanted:
            show.say(
                f"J from the free part: `fluxobs identify LOG --machine {machine} --free J "
                f"--start {sequence.ramps_from:.2f}`."
            )


def _wanted(given: dict[str, str], usual: dict[str, tuple[float, float]]) -> dict[str, float]:
    """Parse standard deviations, as shares in percent or in the unit of the parameter."""
    wanted = {}
    known = [*usual, "J"]
    for name, text in given.items():
        if name not in known:
            raise UsageError(f"--want {name}: unknown{nearest(name, known)}")
        try:
            share = text.endswith("%")
            number = float(text.removesuffix("%")) / (100 if share else 1)
        except ValueError:
            raise UsageError(f"--want {name}={text}: expected 3% or a number") from None
        if share and name not in usual:
            raise UsageError(f"--want {name}={text}: give it in kg m², without %")
        wanted[name] = number * usual[name][1] if share else number
    return wanted
