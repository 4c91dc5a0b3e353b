"""What every machine answers. A new machine is one file with these answers, and one line of
registration (registry.py); docs/contributing says what they mean.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from ..errors import MachineError
from ..model.constraint import QuadraticConstraint
from ..model.frames import Frame
from ..model.inverter import InverterError
from ..validation import Positive, complaints

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Position:
    """What a kind of machine calls its position.

    Attributes
    ----------
    name : str
        Of the output, in rad or m.
    truths : tuple of str
        Channels of a log that may hold the true one.
    factor, unit : float, str
        From SI to the unit in which an error of it is told.
    title : str
        Of a picture.
    """

    name: str
    truths: tuple[str, ...]
    factor: float
    unit: str
    title: str


class Machine(BaseModel):
    """An electromechanical machine with a quadratic relation between flux and current.

    Parameters
    ----------
    rated_current : float, optional
        Peak current of a port [A], > 0. A scale of what is plausible: it needs no precision.

    Raises
    ------
    MachineError
        A parameter is missing, unknown or impossible.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    kind: ClassVar[str]
    #: Reference frame of its logs where none is given.
    frame: ClassVar[Frame] = "alphabeta"
    #: Names of its two ports, with which the names of outputs end.
    ports: ClassVar[tuple[str, str]] = ("alpha", "beta")
    position_output: ClassVar[Position]
    #: Memory of the least squares that serves most of this kind [s].
    memory: ClassVar[float] = 0.03
    #: The relation cannot tell the position from the one half a turn away.
    half_turn_ambiguous: ClassVar[bool] = False
    #: Share of the flux base below which a position vector tells no position.
    shortest: ClassVar[float] = 0.0
    #: Its voltages are measured, noise and all; else they are commands, which have none.
    measured_voltage: ClassVar[bool] = False

    rated_current: Positive | None = None

    def __init__(self, **parameters: Any) -> None:
        try:
            super().__init__(**parameters)
        except ValidationError as error:
            what = complaints(error, self.parameter_names(), f"kind {self.kind}")
            raise MachineError(what) from None

    @classmethod
    def parameter_names(cls) -> list[str]:
        """Names in a machine file."""
        return [field.alias or name for name, field in cls.model_fields.items()]

    # ---- the model --------------------------------------------------------------------

    @property
    def R(self) -> Array:
        """Resistance matrix of ``λ̇ = -R i + B u`` [Ω], (2, 2)."""
        raise NotImplementedError

    @property
    def B(self) -> Array:
        """Input matrix, (2, 2)."""
        raise NotImplementedError

    @property
    def constraint(self) -> QuadraticConstraint:
        """The relation between flux and current. Its d is 0 where it is not known: not needed."""
        raise NotImplementedError

    @property
    def inverter(self) -> InverterError | None:
        """What the inverter takes of a commanded voltage, where it is known."""
        return None

    # ---- sizes ------------------------------------------------------------------------

    def flux_base(self, rated_current: float, psi_f: float | None = None) -> float | None:
        """Size of the flux [Wb]; `psi_f` in place of the machine's own. None: psi_f is needed."""
        raise NotImplementedError

    def constraint_noise(self, flux_base: float, noise: float) -> float:
        """Std of the constraint's residual caused by that std of each current component [A]."""
        raise NotImplementedError

    # ---- the position -----------------------------------------------------------------

    def position(self, flux: ArrayLike, current: ArrayLike) -> tuple[Array, Array]:
        """Position [rad] or [m] and the length of the vector that tells it [Wb].

        Parameters
        ----------
        flux, current : (..., 2) array_like

        Returns
        -------
        position, length : (...) ndarray
        """
        raise NotImplementedError

    def position_std(self, flux: Array, flux_std: Array, current: Array) -> Array:
        """Standard deviation of that position from that of the flux, (...)."""
        raise NotImplementedError

    @property
    def position_span(self) -> float:
        """What a standard deviation of the position is compared with: 1 rad, or the gap [m]."""
        return 1.0

    def true_position(self, channel: str, value: Array) -> Array:
        """The position that a log's channel of truth says: one of ``position_output.truths``."""
        raise NotImplementedError

    def position_error(self, estimated: Array, true: Array) -> Array:
        """Estimated minus true position, wrapped where it is an angle."""
        raise NotImplementedError

    # ---- copies -----------------------------------------------------------------------

    def with_values(self, **values: float | None) -> Self:
        """A copy with other parameters.

        Raises
        ------
        MachineError
            An impossible value, or a parameter that this kind does not have.
        """
        return type(self)(**self.model_dump(by_alias=True) | values)

    def scaled(self, names: Iterable[str], factor: float) -> Self:
        """A copy whose named parameters, as far as they are given, are multiplied."""
        given = {name: getattr(self, name, None) for name in names}
        return self.with_values(**{k: v * factor for k, v in given.items() if v is not None})


def angle_std(flux_std: Array, length: Array) -> Array:
    """Standard deviation of the direction of a vector of that length, (...)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.linalg.norm(flux_std, axis=-1) / np.sqrt(2) / length)
