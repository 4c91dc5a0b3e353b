"""`fluxobs machine new`; `plan` is in plan.py."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from .. import show
from ..options import ForceOption

app = typer.Typer(no_args_is_help=True, help="Write machine files; plan drives.")


@app.callback()
def _group() -> None:
    """Write machine files; plan drives."""


#: Questions asked on a terminal: (field, text). One answer to _MAGNETS is enough.
_MAGNETS = (("kv", "KV [rpm/V]"), ("K_e", "or K_e [V/krpm]"), ("K_t", "or K_t [Nm/A]"))
_LINE = (
    ("R_line", "Resistance between two terminals [Ω]"),
    ("L_line", "Inductance between two terminals [H]"),
)
_AXES = (
    ("R_line", "Resistance between two terminals [Ω]"),
    ("L_line_min", "Smallest inductance between two terminals over a turn [H]"),
    ("L_line_max", "Largest inductance between two terminals over a turn [H]"),
)
_PLATE = (
    ("voltage", "Rated voltage, line to line [V rms]"),
    ("frequency", "Rated frequency [Hz]"),
    ("power", "Rated power [W]"),
    ("current", "Rated current [A rms]"),
    ("speed", "Rated speed [rpm]"),
    ("cos_phi", "cos φ"),
)


def _number_option(name: str, about: str) -> Any:
    return Annotated[float | None, typer.Option(f"--{name}", metavar="NUMBER", help=about)]


@app.command()
def new(
    out: Annotated[Path, typer.Option(help="Machine file to write, .toml.")],
    kind: Annotated[
        str | None,
        typer.Option(
            help="surface-pmsm (also BLDC, hub and drone motors), interior-pmsm, "
            "synchronous-reluctance or induction. Default: ask on a terminal, else "
            "surface-pmsm."
        ),
    ] = None,
    poles: _number_option("poles", "Number of poles.") = None,  # type: ignore[valid-type]
    pole_pairs: _number_option("pole-pairs", "Number of pole pairs, instead of --poles.") = None,  # type: ignore[valid-type]
    values: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="Any field of a machine file or datasheet: R_line=0.8 L_line=1.2e-3 kv=900 "
            "kv_of='line rms' K_e=52 K_t=0.7 (K_t_of=dc: block commutation) rated_current_rms=4 "
            "rated_speed_rpm=3000 …; from the rating plate of an induction machine: voltage=400 "
            "frequency=50 power=2200 current=5 speed=1436 cos_phi=0.82.",
        ),
    ] = None,
    force: ForceOption = False,
) -> None:
    """Write a machine file from the values of a datasheet or rating plate.

    Prints what it computed and assumed. On a terminal, asks for missing values.

    Example: fluxobs machine new --out motor.toml --kind surface-pmsm --poles 14 --set kv=900
    R_line=0.11 L_line=28e-6 rated_current_rms=20
    """
    from ...machines.contract import unit_of
    from ...machines.new import new_machine
    from ...machines.registry import KINDS
    from ...machines.saving import check_machine_file, write_machine
    from ...presentation.summary import si
    from ..options import pairs

    check_machine_file(out, force)
    fields: dict[str, Any] = {
        name: _parse_value(text) for name, text in pairs("set", values).items()
    }
    interactive = show.interactive()
    if kind is None and interactive:
        kind = typer.prompt("Kind of machine", default="surface-pmsm")
    kind_is_assumed, kind = kind is None, kind or "surface-pmsm"
    if poles is not None:
        fields["poles"] = poles
    if pole_pairs is not None:
        fields["n_p"] = int(pole_pairs)
    if interactive and kind in KINDS:
        _ask_missing(kind, fields)
    result = new_machine(kind, fields)
    write_machine(out, result.machine, result.head, {}, force)
    typer.echo(result.text, nl=False)
    if result.computed:
        values = [f"{name} = {si(value, unit_of(name))}" for name, value in result.computed.items()]
        show.echo(f"Computed: {', '.join(value.strip() for value in values)}.")
    for assumption in [
        *(["kind is surface-pmsm (--kind)"] if kind_is_assumed else []),
        *result.assumed,
    ]:
        show.echo(f"Assumed: {assumption}.")
    show.say(
        f"Written: {out}. `fluxobs check LOG --machine {out}` detects a wrong factor of √3 or 2."
    )


def _parse_value(text: str) -> Any:
    try:
        number = float(text)
    except ValueError:
        return text
    return int(number) if number.is_integer() and "." not in text and "e" not in text else number


def _ask_missing(kind: str, fields: dict[str, Any]) -> None:
    """Ask for missing fields; an empty answer leaves a field out."""
    if kind == "induction":
        questions = [] if "R_s" in fields else [q for q in _PLATE if q[0] not in fields]
    else:
        axes = kind in ("interior-pmsm", "synchronous-reluctance")
        questions = [] if {"R_s", "R_phase"} & set(fields) else list(_AXES if axes else _LINE)
        if not {"n_p", "poles"} & set(fields):
            questions.insert(0, ("poles", "Number of poles"))
        if kind != "synchronous-reluctance" and not {"psi_f", "kv", "K_e", "K_t"} & set(fields):
            questions += _MAGNETS
        questions.append(("rated_current_rms", "Rated current [A rms]"))
    magnet_known = False
    for name, question in questions:
        is_magnet = name in dict(_MAGNETS)
        if name in fields or (is_magnet and magnet_known):
            continue
        answer = typer.prompt(question, default="", show_default=False)
        if answer.strip():
            fields[name] = _parse_value(answer.strip())
            magnet_known = magnet_known or is_magnet
