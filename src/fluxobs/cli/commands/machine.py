"""`fluxobs machine new`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from .. import show
from ..options import ForceOption

app = typer.Typer(no_args_is_help=True, help="Write machine files.")


@app.callback()
def _group() -> None:
    """Write machine files."""


#: What is asked on a terminal, for each kind: field, question; the first that is answered of a
#: group in brackets ends it.
_MAGNETS = (("kv", "KV [rpm/V]"), ("K_e", "or K_e [V/krpm]"), ("K_t", "or K_t [Nm/A]"))
_LINE = (
    ("R_line", "Resistance between two terminals [Ω]"),
    ("L_line", "Inductance between two terminals [H]"),
)
_AXES = (
    ("R_line", "Resistance between two terminals [Ω]"),
    ("L_line_min", "Least inductance between two terminals over a turn [H]"),
    ("L_line_max", "Most inductance between two terminals over a turn [H]"),
)
_PLATE = (
    ("voltage", "Rated voltage, line to line [V rms]"),
    ("frequency", "Rated frequency [Hz]"),
    ("power", "Rated power [W]"),
    ("current", "Rated current [A rms]"),
    ("speed", "Rated speed [rpm]"),
    ("cos_phi", "cos φ"),
)


def _number(name: str, about: str) -> Any:
    return Annotated[float | None, typer.Option(f"--{name}", metavar="NUMBER", help=about)]


@app.command()
def new(
    out: Annotated[Path, typer.Option(help="Machine file to write, .toml.")],
    kind: Annotated[
        str | None,
        typer.Option(
            help="surface-pmsm (also BLDC, hub, drone motors), interior-pmsm, "
            "synchronous-reluctance, induction. Asked for if missing."
        ),
    ] = None,
    poles: _number("poles", "Number of poles.") = None,  # type: ignore[valid-type]
    pole_pairs: _number("pole-pairs", "Or of pole pairs.") = None,  # type: ignore[valid-type]
    values: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="Any field of a machine file or of a datasheet: R_line=0.8 L_line=1.2e-3 kv=900 "
            "kv_of='line rms' K_e=52 K_t=0.7 (K_t_of=dc: with block commutation) "
            "rated_current_rms=4 rated_speed_rpm=3000 …; for an induction machine voltage=400 "
            "frequency=50 power=2200 current=5 speed=1436 cos_phi=0.82 of its plate.",
        ),
    ] = None,
    force: ForceOption = False,
) -> None:
    """Write a machine file from a datasheet or a rating plate; says what it assumed.

    Asks for what is missing, if it runs on a terminal.

    Example: fluxobs machine new --out motor.toml --kind surface-pmsm --poles 14 --set kv=900
    R_line=0.11 L_line=28e-6 rated_current_rms=20
    """
    from ...machines.new import new_machine
    from ...machines.registry import KINDS
    from ...machines.saving import check_machine_file, write_machine
    from ..options import pairs

    check_machine_file(out, force)
    given: dict[str, Any] = {name: _value(text) for name, text in pairs("set", values).items()}
    ask = show.interactive()
    if kind is None and ask:
        kind = typer.prompt("Kind of machine", default="surface-pmsm")
    unasked, kind = kind is None, kind or "surface-pmsm"
    if poles is not None:
        given["poles"] = poles
    if pole_pairs is not None:
        given["n_p"] = int(pole_pairs)
    if ask and kind in KINDS:
        _ask(kind, given)
    made = new_machine(kind, given)
    write_machine(out, made.machine, made.head, {}, force)
    typer.echo(made.text, nl=False)
    for line in [*(["kind is surface-pmsm (--kind)"] if unasked else []), *made.assumed]:
        show.echo(f"Assumed: {line}.")
    show.say(f"Written: {out}. `fluxobs check LOG --machine {out}` finds a √3 or a 2 too much.")


def _value(text: str) -> Any:
    try:
        number = float(text)
    except ValueError:
        return text
    return int(number) if number.is_integer() and "." not in text and "e" not in text else number


def _ask(kind: str, given: dict[str, Any]) -> None:
    """Ask for what is not given; an empty answer leaves a field out."""
    if kind == "induction":
        questions = [] if "R_s" in given else [q for q in _PLATE if q[0] not in given]
    else:
        axes = kind in ("interior-pmsm", "synchronous-reluctance")
        questions = [] if {"R_s", "R_phase"} & set(given) else list(_AXES if axes else _LINE)
        if not {"n_p", "poles"} & set(given):
            questions.insert(0, ("poles", "Number of poles"))
        if kind != "synchronous-reluctance" and not {"psi_f", "kv", "K_e", "K_t"} & set(given):
            questions += _MAGNETS
        questions.append(("rated_current_rms", "Rated current [A rms]"))
    done = False
    for name, question in questions:
        magnets = name in dict(_MAGNETS)
        if name in given or (magnets and done):
            continue
        answer = typer.prompt(question, default="", show_default=False)
        if answer.strip():
            given[name] = _value(answer.strip())
            done = done or magnets
