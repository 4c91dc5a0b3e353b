"""Inputs and outputs of an exported observer, with their names in hosts other than C."""

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
    """A number that is an input or output.

    Attributes
    ----------
    name, unit, about : str
        Texts; a ratio has an empty unit.
    boolean : bool
    member : str
        Member of the estimate in C; empty for an input.
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
#: Further outputs of the adaptive observer.
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
        "Second possible angle while the angle is ambiguous",
        member="theta_other",
    ),
    Variable("weight_other", "", "Weight of the second angle, 0 to 1/2", member="weight_other"),
    Variable(
        "adapting", "", "Whether the filter for these quantities runs", True, member="adapting"
    ),
)


def output_variables(core: Core) -> tuple[Variable, ...]:
    """Return the outputs, first those of the test vectors in the order of the vectors."""
    variables = []
    for output in outputs(Estimate):
        inner = "position." if core.adaptive and output.name != "psi_f" else ""
        name, unit, about = output.name, output.unit, output.about.rstrip(".")
        if output.vector:
            for n, axis in enumerate(("alpha", "beta")):
                member = f"{inner}{name}[{n}]"
                variables.append(Variable(f"{name}_{axis}", unit, about, member=member))
        else:
            variables.append(Variable(name, unit, about, output.boolean, f"{inner}{name}"))
    return (*variables, *(ADAPTIVE if core.adaptive else ()))


def check_every_step(core: Core, form: str) -> None:
    """Raise FluxobsError if the observer steps only every few interrupts."""
    if core.update_every > 1:
        raise FluxobsError(
            f"update_every {core.update_every}: {form} steps at every call; leave update_every out "
            f"and give the time between two calls as the sample time"
        )


def c_values(core: Core, number: str) -> str:
    """Return the outputs of an estimate ``e`` as initialisers of a C array."""
    rows = (
        f"e->{output.member} ? 1.0 : 0.0," if output.boolean else f"({number})e->{output.member},"
        for output in output_variables(core)
    )
    return "\n".join(f"        {row}" for row in rows)


def record_csv(core: Core, precision: Precision = "double") -> str:
    """Return the record and its expected outputs as CSV with all digits."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = [variable.name for variable in output_variables(core)][: len(COLUMNS)]
    writer.writerow([*(variable.name for variable in INPUTS), *names])
    expected_rows = expected(core.estimates[precision])
    for sample, estimate in zip(inputs(core.record), expected_rows, strict=True):
        writer.writerow([*map(repr, sample.tolist()), *map(repr, estimate.tolist())])
    return text.getvalue()
