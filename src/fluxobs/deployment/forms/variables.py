"""Inputs and outputs of an exported observer, as hosts other than C name them."""

from __future__ import annotations

from dataclasses import dataclass

from ...errors import FluxobsError
from ...observers import Estimate, outputs
from ..core import Core


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
_MORE = (
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
    return (*found, *(_MORE if core.adaptive else ()))


def check_every_step(core: Core, form: str) -> None:
    """Raise FluxobsError if the observer steps only every few interrupts."""
    if core.update_every > 1:
        raise FluxobsError(
            f"update_every {core.update_every}: {form} steps at every call; leave it out, and give "
            f"the time between two calls as the sample time"
        )
