"""`fluxobs export`."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from .. import show
from ..options import MachineOption, PriorOption, numbers


def export(
    machine: MachineOption,
    sample_time: Annotated[
        float, typer.Option(help="Seconds; period of the current-control interrupt.")
    ],
    out: Annotated[Path, typer.Option(help="Folder to make.")],
    unknowns: Annotated[
        str,
        typer.Option(
            help="Constant or slow unknowns: drift, or also some of resistance, inverter, "
            "asymmetry (auto: all). These export the adaptive observer, which starts within a "
            "fraction of a turn."
        ),
    ] = "drift",
    memory: Annotated[
        float | None,
        typer.Option(
            help="Seconds; memory of the least squares. Default 0.03, or less if L/R is short."
        ),
    ] = None,
    current_noise: Annotated[
        float | None,
        typer.Option(
            help="Ampere, standard deviation of a component; default 0.2 % of the rated current. "
            "`fluxobs estimate` prints what it used for a log."
        ),
    ] = None,
    drift_prior: Annotated[
        float | None, typer.Option(help="Volt; largest plausible drift. Default from the machine.")
    ] = None,
    prior: PriorOption = None,
    update_every: Annotated[
        int,
        typer.Option(
            help="Interrupts from one step of the observer to the next. Above 1 it saves computing "
            "time: the example gathers volt-seconds in between."
        ),
    ] = 1,
    prefix: Annotated[
        str,
        typer.Option(
            help="Prefix of the generated names, so that two machines fit into one firmware."
        ),
    ] = "motor",
    form: Annotated[
        str,
        typer.Option(
            "--as",
            help="c: C99 for any firmware; arduino: library for the Arduino IDE and PlatformIO; "
            "fmu: simulation units, FMI 3.0 and 2.0; wasm: module for browsers and others; "
            "rust: crate without dependencies.",
        ),
    ] = "c",
    force: Annotated[bool, typer.Option("--force", help="Overwrite an earlier export.")] = False,
) -> None:
    """Write the observer for one machine as C99 for its firmware, or for another host.

    The folder holds the sources, the machine's parameters, an example interrupt, and test vectors
    with a host test: `make test` in it replays them. Sample by sample, it computes what
    `fluxobs estimate` computes. `--as` makes a library, a unit or a module of the same.

    Example: fluxobs export --machine motor.toml --sample-time 5e-5 --out firmware/motor
    """
    from ... import export as run
    from ...deployment.forms import FORMS

    done = run(
        machine,
        sample_time,
        out,
        memory=memory,
        unknowns=unknowns,
        current_noise=current_noise,
        drift_prior=drift_prior,
        priors=numbers("prior", prior),
        update_every=update_every,
        prefix=prefix,
        form=form,
        force=force,
    )
    folder = shlex.quote(str(done.folder))
    attempt = FORMS[form].format(folder=folder)
    show.say(f"Written: {folder}, content {done.content}. Try: {attempt}")
