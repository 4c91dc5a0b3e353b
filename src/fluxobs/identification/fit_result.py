"""Result of an identification, with everything that the report needs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from ..machines import RotatingMachine
from .fit import ParameterFit
from .map_fit import FoundMap
from .segments import Segment

UNITS = {"R_s": "Ω", "R_R": "Ω", "L_s": "H", "L_d": "H", "L_q": "H", "L_M": "H", "psi_f": "Wb"}
UNITS |= {"inverter": "V"}
ADVICE = (
    "Record a log with steps of load at several speeds, a run-up from standstill, or both "
    "directions: the effect of the resistance depends on the current, that of the inverter on the "
    "current's sign, that of the magnet on the speed, and that of a lag on current and speed"
)


@dataclass(frozen=True)
class Parameter:
    """One parameter: given value, identified value, standard deviation (None if held)."""

    name: str
    unit: str
    given: float | None
    value: float
    std: float | None


def in_the_file(parameters: Iterable[Parameter]) -> dict[str, tuple[float, float]]:
    """Return the fitted parameters: name in the machine file → (value, standard deviation)."""
    return {
        "inverter_voltage" if p.name == "inverter" else p.name: (p.value, p.std)
        for p in parameters
        if p.std is not None and p.name != "lag"
    }


@dataclass(frozen=True, eq=False)
class FittedParameters:
    """Parameters identified from a log.

    Attributes
    ----------
    machine : RotatingMachine
        The machine with the identified values; all other values are as given.
    parameters : list of Parameter
        All parameters that `--free` names, in the same order.
    untold : dict
        Parameter name → why this log cannot identify this parameter.
    lag : float
        Voltage lag that fits best [samples]; if not free, the given lag.
    before, after : ParameterFit
        The fit with the given values, where only the magnet flux is free, and the final fit.
    inverter_current : float
        Current at which the inverter's sign is smoothed [A].
    pieces : list of Segment
        Segments of the log that were used.
    rows : int
        Rows of the log.
    source : str
        Name of the log.
    map : FoundMap, optional
        The flux map; None if the map was not free.
    """

    machine: RotatingMachine
    parameters: list[Parameter]
    untold: dict[str, str]
    lag: float
    before: ParameterFit
    after: ParameterFit
    pieces: list[Segment]
    inverter_current: float
    rows: int
    source: str = ""
    map: FoundMap | None = None

    @property
    def facts(self) -> dict[str, Any]:
        """The parameters as JSON can hold them."""
        return {
            "rows": self.rows,
            "lag": self.lag,
            "parameters": {
                parameter.name: {
                    "value": parameter.value,
                    "std": parameter.std,
                    "given": parameter.given,
                    "unit": parameter.unit,
                }
                for parameter in self.parameters
            },
            "untold": dict(self.untold),
        }

    @property
    def found(self) -> dict[str, tuple[float, float]]:
        """Identified parameters: name in the machine file → (value, standard deviation)."""
        return in_the_file(self.parameters)
