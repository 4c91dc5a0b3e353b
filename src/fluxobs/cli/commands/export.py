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
        float, typer.Option(help="Period of the current-control interrupt in seconds.")
    ],
    out: Annotated[Path, typer.Option(help="Folder to create.")],
    unknowns: Annotated[
        str,
        typer.Option(
            help="Unknowns to estimate: auto (all, as in `fluxobs estimate`), or drift with some "
            "of resistance, inverter, asymmetry: the adaptive observer. drift alone: the plain "
            "observer, which needs a third of the time and the right parameters."
        ),
    ] = "auto",
    memory: Annotated[
        float | None,
        typer.Option(
            help="Memory of the least squares in seconds. Default 0.03, or less if L/R is small."
        ),
    ] = None,
    current_noise: Annotated[
        float | None,
        typer.Option(
            help="Standard deviation of each current component in amperes. Default 0.2 % of the "
            "rated current. `fluxobs estimate` prints the value used for a log."
        ),
    ] = None,
    drift_prior: Annotated[
        float | None,
        typer.Option(help="Largest plausible drift in volts. Default: computed from the machine."),
    ] = None,
    prior: PriorOption = None,
    update_every: Annotated[
        int,
        typer.Option(
            help="Number of interrupts per observer step. A number above 1 saves computing time; "
            "the example interrupt sums up volt-seconds between the steps."
        ),
    ] = 1,
    prefix: Annotated[
        str,
        typer.Option(
            help="Prefix of the generated names; two prefixes allow two machines in one firmware."
        ),
    ] = "motor",
    form: Annotated[
        str,
        typer.Option(
            "--as",
            help="c: C99 for any firmware; arduino: library for the Arduino IDE and PlatformIO; "
            "fmu: simulation units for FMI 3.0 and 2.0; wasm: WebAssembly module, for example for "
            "browsers; rust: crate without dependencies.",
        ),
    ] = "c",
    force: Annotated[bool, typer.Option("--force", help="Overwrite an earlier export.")] = False,
) -> None:
    """Export the observer of one machine for firmware.

    The folder contains the observer in C99 (or in the form for another host: --as), the machine's
    parameters, an example interrupt, and test vectors. `make test` in the folder replays the
    vectors on this computer. The export computes the same estimates as `fluxobs estimate
    --causal`, sample by sample.

    Example: fluxobs export --machine motor.toml --sample-time 5e-5 --out firmware/motor
    """
    from ... import export as run
    from ...deployment.forms import FORMS

    exported = run(
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
    folder = shlex.quote(str(exported.folder))
    attempt = FORMS[form].format(folder=folder)
    show.say(f"Written: {folder}, content {exported.content}. Try: {attempt}")
