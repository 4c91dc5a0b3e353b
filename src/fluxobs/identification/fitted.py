"""What an identification found: all that its report needs."""

from __future__ import annotations

from dataclasses import dataclass

from ..machines import RotatingMachine
from .fit import Fit
from .pieces import Piece

UNITS = {"R_s": "Ω", "L_s": "H", "L_d": "H", "L_q": "H", "psi_f": "Wb", "inverter": "V"}
ADVICE = (
    "Record one with steps of load at several speeds, a run-up from rest, or both directions: a "
    "resistance acts with the current, an inverter with its sign, a magnet with the speed, a lag "
    "with both"
)


@dataclass(frozen=True)
class Parameter:
    """One parameter: as given, as found, and its standard deviation; none where it was held."""

    name: str
    unit: str
    given: float | None
    value: float
    std: float | None


@dataclass(frozen=True, eq=False)
class Fitted:
    """Parameters of a log.

    Attributes
    ----------
    machine : RotatingMachine
        With what was found; the rest as given.
    parameters : list of Parameter
        All that were to be free, in the order of `--free`.
    untold : dict
        Name → why this log cannot tell it.
    lag : float
        Voltage lag that fits best [samples]; as given unless free.
    before, after : Fit
        As given, the magnet flux of a machine that has magnets fitted; and the final one.
    inverter_current : float
        At which the inverter's sign is smoothed [A].
    pieces : list of Piece
        Of the log, that were used.
    rows : int
        Of the log.
    source : str
        The log's name.
    """

    machine: RotatingMachine
    parameters: list[Parameter]
    untold: dict[str, str]
    lag: float
    before: Fit
    after: Fit
    pieces: list[Piece]
    inverter_current: float
    rows: int
    source: str = ""
