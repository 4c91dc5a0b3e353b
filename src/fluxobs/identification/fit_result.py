"""What an identification found: all that its report needs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from ..machines import RotatingMachine
from .fit import ParameterFit
from .map_fit import FoundMap
from .segments import Piece

UNITS = {"R_s": "Ω", "R_R": "Ω", "L_s": "H", "L_d": "H", "L_q": "H", "L_M": "H", "psi_f": "Wb"}
UNITS |= {"inverter": "V"}
ADVICE = (
    "Record one with steps of load at several speeds, a run-up from rest, or both directions: the "
    "resistance acts with the current, the inverter with its sign, the magnet with the speed, and "
    "a lag with both"
)


@dataclass(frozen=True)
class Parameter:
    """One parameter: as given, as found, and its standard deviation, None if it was held."""

    name: str
    unit: str
    given: float | None
    value: float
    std: float | None


def in_the_file(parameters: Iterable[Parameter]) -> dict[str, tuple[float, float]]:
    """Name in the machine file → value and standard deviation, of what was not held."""
    return {
        "inverter_voltage" if p.name == "inverter" else p.name: (p.value, p.std)
        for p in parameters
        if p.std is not None and p.name != "lag"
    }


@dataclass(frozen=True, eq=False)
class FittedParameters:
    """Parameters of a log.

    Attributes
    ----------
    machine : RotatingMachine
        With the values found; the rest as given.
    parameters : list of Parameter
        All that `--free` names, in its order.
    untold : dict
        Name → why this log cannot tell it.
    lag : float
        Voltage lag that fits best [samples]; as given unless free.
    before, after : ParameterFit
        The fit as given, in which only the flux of magnets is fitted, and the final fit.
    inverter_current : float
        Current at which the inverter's sign is smoothed [A].
    pieces : list of Piece
        Pieces of the log that were used.
    rows : int
        Rows of the log.
    source : str
        The log's name.
    map : FoundMap, optional
        The flux map, if it was free.
    """

    machine: RotatingMachine
    parameters: list[Parameter]
    untold: dict[str, str]
    lag: float
    before: ParameterFit
    after: ParameterFit
    pieces: list[Piece]
    inverter_current: float
    rows: int
    source: str = ""
    map: FoundMap | None = None

    @property
    def facts(self) -> dict[str, Any]:
        """What was found, as JSON can hold it."""
        return {
            "rows": self.rows,
            "lag": self.lag,
            "parameters": {
                one.name: {
                    "value": one.value,
                    "std": one.std,
                    "given": one.given,
                    "unit": one.unit,
                }
                for one in self.parameters
            },
            "untold": dict(self.untold),
        }

    @property
    def found(self) -> dict[str, tuple[float, float]]:
        """Name in the machine file → value and standard deviation, of what the log told."""
        return in_the_file(self.parameters)
