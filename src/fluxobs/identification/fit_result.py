"""Result of an identification, with everything that the report needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..machines import RotatingMachine
from ..presentation import Result
from .map_fit import FoundMap
from .mechanics import Mechanics
from .segment_fit import SegmentFit
from .values import Parameter, in_the_file


@dataclass(frozen=True, eq=False)
class FittedParameters:
    """Parameters identified from a log.

    Attributes
    ----------
    machine : RotatingMachine
        The machine with the identified values; all other values are as given.
    parameters : tuple of Parameter
        All parameters that `free` names, in the same order.
    untold : dict
        Parameter name → why this log cannot identify this parameter.
    lag : float
        Lag with which the log was read, stated or learnt [samples].
    rows : int
        Rows of the logs.
    source : str
        Name of the log.
    run : Result, optional
        The estimate that identified the parameters; None for many logs, and for a map or a rotor.
    segment_fit : SegmentFit, optional
        The fit of a map or a rotor.
    mechanics : Mechanics, optional
        Inertia, friction and load, if `free` names one of these.
    """

    machine: RotatingMachine
    parameters: tuple[Parameter, ...]
    untold: dict[str, str]
    lag: float
    rows: int
    source: str
    run: Result | None
    segment_fit: SegmentFit | None
    mechanics: Mechanics | None = None

    @property
    def map(self) -> FoundMap | None:
        """The flux map; None if the map was not free."""
        return None if self.segment_fit is None else self.segment_fit.map

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
