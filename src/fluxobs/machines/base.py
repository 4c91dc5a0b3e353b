"""What every machine has: parameters in SI, a constraint, R and B."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from ..constraint import QuadraticConstraint
from ..errors import MachineError
from ..frames import Frame
from ..inverter import SMOOTHING, InverterError
from ..validation import Number, Positive

PolePairs = Annotated[int, Field(ge=1)]


class Machine(BaseModel):
    """An electromechanical machine with a quadratic relation between flux and current.

    Parameters
    ----------
    rated_current : float, optional
        Peak current of a port [A], > 0; sets the scale of what is plausible, needs no precision.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    kind: ClassVar[str]
    #: Reference frame of its logs where none is given.
    frame: ClassVar[Frame] = "alphabeta"
    #: Memory of the least squares that serves most of this kind [s].
    memory: ClassVar[float] = 0.03

    rated_current: Positive | None = None

    @property
    def R(self) -> NDArray[np.float64]:
        """Resistance matrix of ``λ̇ = -R i + B u`` [Ω], (2, 2)."""
        raise NotImplementedError

    @property
    def B(self) -> NDArray[np.float64]:
        """Input matrix, (2, 2)."""
        raise NotImplementedError

    @property
    def constraint(self) -> QuadraticConstraint:
        """The relation between flux and current. Its d is 0 where it is not known: not needed."""
        raise NotImplementedError

    def flux_base(self, psi_f: float | None, rated_current: float) -> float | None:
        """Size of the flux [Wb] from what is known; None if a magnet flux is needed."""
        raise NotImplementedError

    def constraint_noise(self, flux_base: float, rated_current: float, noise: float) -> float:
        """Std of the constraint's residual caused by that std of each current component [A]."""
        raise NotImplementedError


class RotatingMachine(Machine):
    """A three-phase machine in αβ: per-phase (star) values, amplitude-invariant vectors.

    Current is positive into the machine; phases a-b-c follow each other at positive speed.

    Parameters
    ----------
    R_s : float
        Phase resistance [Ω], > 0.
    n_p : int
        Pole pairs, >= 1.
    rated_current : float, optional
        Peak phase current [A], > 0; sets the scale of what is plausible, needs no precision.
    inverter_voltage : float, optional
        What dead time and device drops take of a phase's voltage [V]; taken off a log's commands.
    inverter_current : float, optional
        Phase current at which the inverter's smoothed sign counts three quarters [A], > 0; default
        5 % of rated_current.
    """

    #: The relation cannot tell the position from the one half a turn away.
    half_turn_ambiguous: ClassVar[bool] = False
    #: Share of the flux base below which a position vector is none.
    shortest: ClassVar[float] = 0.25

    R_s: Positive
    n_p: PolePairs
    inverter_voltage: Number | None = None
    inverter_current: Positive | None = None

    @property
    def inverter(self) -> InverterError | None:
        """The inverter's error, where it is known."""
        if not self.inverter_voltage:
            return None
        smoothing = self.inverter_current or SMOOTHING * (self.rated_current or 0.0)
        if not smoothing:
            raise MachineError(
                "inverter_voltage needs inverter_current, the phase current below which its sign "
                "is smoothed [A], or rated_current"
            )
        return InverterError(self.inverter_voltage, smoothing)

    @property
    def R(self) -> NDArray[np.float64]:
        return self.R_s * np.eye(2)

    @property
    def B(self) -> NDArray[np.float64]:
        return np.eye(2)

    @property
    def position_inductance(self) -> float:
        """L of the position vector ``λ - L i`` [H], which points along the rotor's d axis."""
        raise NotImplementedError

    @property
    def saliency(self) -> float:
        """L_d - L_q [H]: the position vector has the length ``ψ_f + saliency · i_d``."""
        return 0.0
