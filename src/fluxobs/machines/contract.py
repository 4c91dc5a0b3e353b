"""The interface of every machine.

A new kind of machine needs one file with a subclass, and one line in registry.py.
docs/contributing.md explains the members.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, ValidationError

from .. import _core
from ..core.arrays import Array
from ..core.validation import Positive, complaints
from ..errors import MachineError
from .model.constraint import QuadraticConstraint
from .model.frames import Frame
from .model.inverter import InverterError


@dataclass(frozen=True)
class Position:
    """Names and unit of the position of one kind of machine.

    Attributes
    ----------
    name : str
        Name of the output, in rad or m.
    truths : tuple of str
        Channels of a log that can hold the true position.
    factor, unit : float, str
        Unit of stated errors, and the factor from SI to this unit.
    title : str
        Title of its picture.
    """

    name: str
    truths: tuple[str, ...]
    factor: float
    unit: str
    title: str


#: Unit of a parameter, by the prefix of its name.
_UNITS = {"R_": "Ω", "L_": "H", "psi": "Wb", "rated_current": "A", "rated_speed": "rad/s"}
_UNITS |= {"inverter_voltage": "V", "inverter_current": "A", "n_p": "pole pairs"}


def unit_of(parameter: str) -> str:
    """Return the unit of a rotating machine's parameter, or "" if its name has no known prefix."""
    if parameter.endswith("_share"):
        return ""
    return next((unit for prefix, unit in _UNITS.items() if parameter.startswith(prefix)), "")


class Machine(BaseModel):
    """An electromechanical machine with a quadratic relation between flux and current.

    Parameters
    ----------
    rated_current : float, optional
        Peak current of a port [A], > 0. Scale of plausible values; a rough value suffices.

    Raises
    ------
    MachineError
        A parameter is missing, unknown or impossible.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    kind: ClassVar[str]
    #: Default reference frame of this kind's logs.
    frame: ClassVar[Frame] = "alphabeta"
    #: Names of the two ports, which are the suffixes of the outputs.
    ports: ClassVar[tuple[str, str]] = ("alpha", "beta")
    position_output: ClassVar[Position]
    #: Usual memory of the least squares for machines of this kind [s].
    memory: ClassVar[float] = _core.usual["MEMORY"]
    #: Whether the relation also holds at the opposite angle.
    half_turn_ambiguous: ClassVar[bool] = False
    #: A position vector shorter than this share of the flux base gives no position.
    shortest: ClassVar[float] = 0.0
    #: True if voltages are measured and noisy, false if voltages are commands without noise.
    measured_voltage: ClassVar[bool] = False

    rated_current: Positive | None = None

    def __init__(self, **parameters: Any) -> None:
        try:
            super().__init__(**parameters)
        except ValidationError as error:
            message = complaints(error, self.parameter_names(), f"kind {self.kind}")
            raise MachineError(message) from None

    @classmethod
    def parameter_names(cls) -> list[str]:
        """Return the names that the parameters have in a machine file."""
        return [field.alias or name for name, field in cls.model_fields.items()]

    def parameters(self) -> dict[str, Any]:
        """Return the values by their names in a machine file; a missing value is None."""
        fields = type(self).model_fields.items()
        return {field.alias or name: getattr(self, name) for name, field in fields}

    def _repr_html_(self) -> str:
        """Return a table of the given parameters, for notebooks."""
        from ..core.html import table

        given = {name: value for name, value in self.parameters().items() if value is not None}
        rows = [(name, str(value), unit_of(name)) for name, value in given.items()]
        return table(("parameter", "value", "unit"), rows, self.kind)

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
        """Relation between flux and current. d is 0 if unknown, since no observer needs d."""
        raise NotImplementedError

    @property
    def inverter(self) -> InverterError | None:
        """Voltage error of the inverter; None if not given."""
        return None

    # ---- sizes ------------------------------------------------------------------------

    def flux_base(self, rated_current: float, psi_f: float | None = None) -> float | None:
        """Return the scale of the flux [Wb]; a given `psi_f` replaces the machine's.

        Return None if both values are missing.
        """
        raise NotImplementedError

    def constraint_noise(self, flux_base: float, noise: float) -> float:
        """Return the std of the constraint's residual for currents with the std `noise` [A]."""
        raise NotImplementedError

    # ---- the position -----------------------------------------------------------------

    def position(self, flux: ArrayLike, current: ArrayLike) -> tuple[Array, Array]:
        """Return the position [rad] or [m] and the length of the position vector [Wb].

        Parameters
        ----------
        flux, current : (..., 2) array_like

        Returns
        -------
        position, length : (...) ndarray
        """
        raise NotImplementedError

    def position_std(self, flux: Array, flux_std: Array, current: Array) -> Array:
        """Return the standard deviation of the position, given that of the flux; shape (...)."""
        raise NotImplementedError

    @property
    def position_span(self) -> float:
        """Scale of the position's standard deviation: 1 rad, or the gap [m]."""
        return 1.0

    def true_position(self, channel: str, value: Array) -> Array:
        """Return the true position, given a log's channel that is in ``position_output.truths``."""
        raise NotImplementedError

    def position_error(self, estimated: Array, true: Array) -> Array:
        """Return the estimated minus the true position, wrapped if the position is an angle."""
        raise NotImplementedError

    # ---- copies -----------------------------------------------------------------------

    def with_values(self, **values: Any) -> Self:
        """Return a copy with other parameters.

        Raises
        ------
        MachineError
            A value is impossible, or this kind has no such parameter.
        """
        return type(self)(**self.parameters() | values)

    def scaled(self, names: Iterable[str], factor: float) -> Self:
        """Return a copy with the named parameters multiplied by `factor`; skip missing values."""
        values = {name: getattr(self, name, None) for name in names}
        return self.with_values(**{k: v * factor for k, v in values.items() if v is not None})


def angle_std(flux_std: Array, length: Array) -> Array:
    """Return the standard deviation of the direction of a vector; shape (...)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.linalg.norm(flux_std, axis=-1) / np.sqrt(2) / length)
