"""Inputs and outputs of an exported observer, and how hosts other than C name them."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass

from ..errors import FluxobsError
from ..observers import Estimate, outputs
from .c_source import Precision
from .core import Core
from .vectors import COLUMNS, expected, inputs


@dataclass(frozen=True)
class Variable:
    """An input or an output, a number.

    Attributes
    ----------
    name, unit, about : str
        The unit is empty for a ratio.
    boolean : bool
    member : str
        Of the estimate in C; of an input empty.
    """

    name: str
    unit: str
    about: str
    boolean: bool = False
    member: str = ""


INPUTS = (
    Variable("u_alpha", "V", "Mean voltage over the interval that ends now, along alpha"),
    Variable("u_beta", "V", "The same along beta"),
    Variable("i_alpha", "A", "Current now, along alpha, positive into the machine"),
    Variable("i_beta", "A", "The same along beta"),
)
#: What the adaptive observer adds.
ADAPTIVE = (
    Variable("psi_f_std", "Wb", "Standard deviation of psi_f", member="psi_f_std"),
    Variable(
        "drift_std", "V", "Standard deviation of a component of the drift", member="drift_std"
    ),
    Variable(
        "resistance_error", "ohm", "Resistance, true minus assumed", member="resistance_error"
    ),
    Variable("resistance_std", "ohm", "Its standard deviation", member="resistance_std"),
    Variable(
        "inverter_voltage", "V", "Dead time and device drops of a phase", member="inverter_voltage"
    ),
    Variable("inverter_std", "V", "Its standard deviation", member="inverter_std"),
    Variable(
        "theta_other",
        "rad",
        "While two angles are in question, the other one",
        member="theta_other",
    ),
    Variable("weight_other", "", "Its weight, 0 to 1/2", member="weight_other"),
    Variable("adapting", "", "The filter for all of these runs", True, member="adapting"),
)


def output_variables(core: Core) -> tuple[Variable, ...]:
    """The outputs: first those of the test vectors, in their order."""
    found = []
    for one in outputs(Estimate):
        inner = "position." if core.adaptive and one.name != "psi_f" else ""
        about = one.about.rstrip(".")
        if one.vector:
            for n, axis in enumerate(("alpha", "beta")):
                member = f"{inner}{one.name}[{n}]"
                found.append(Variable(f"{one.name}_{axis}", one.unit, about, member=member))
        else:
            member = f"{inner}{one.name}"
            found.append(Variable(one.name, one.unit, about, one.boolean, member))
    return (*found, *(ADAPTIVE if core.adaptive else ()))


def check_every_step(core: Core, form: str) -> None:
    """Raise FluxobsError if the observer steps only every few interrupts."""
    if core.update_every > 1:
        raise FluxobsError(
            f"update_every {core.update_every}: {form} steps at every call; leave it out, and give "
            f"the time between two calls as the sample time"
        )


def c_values(core: Core, number: str) -> str:
    """The outputs as values of an array in C, of an estimate ``e``."""
    rows = (
        f"e->{one.member} ? 1.0 : 0.0," if one.boolean else f"({number})e->{one.member},"
        for one in output_variables(core)
    )
    return "\n".join(f"        {row}" for row in rows)


def record_csv(core: Core, precision: Precision = "double") -> str:
    """The record and its expected outputs in a precision, every digit."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = [one.name for one in output_variables(core)][: len(COLUMNS)]
    writer.writerow([*(one.name for one in INPUTS), *names])
    outputs_of = expected(core.estimates[precision])
    for given, found in zip(inputs(core.record), outputs_of, strict=True):
        writer.writerow([*map(repr, given.tolist()), *map(repr, found.tolist())])
    return text.getvalue()
