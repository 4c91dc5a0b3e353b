"""The usual mistakes with a log or machine file, and their effect on vectors and parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..core.arrays import Array
from ..logs.record import LAGS, signed
from ..machines.model.frames import PHASE_CURRENTS, clarke, three_phases
from .relation import Prior
from .segments import Complex

#: Standard deviations of ln R (hot copper), ln L (saturation) and ln ψ (heat) in a machine file,
#: and of V_d as a share of the voltage. Machine files seldom hold V_d.
SPREAD = np.array([0.25, 0.15, 0.08, 0.1])
#: Standard deviation of the logarithm of an unknown factor. A factor of 1000 is two of these
#: standard deviations.
WIDE = 3.5
#: Cost of a mistake: twice the logarithm of its odds, which are one log in twelve.
ODDS = 5.0


@dataclass(frozen=True)
class Linear:
    """Linear map of a vector: z → turn · z + mirror · conj(z)."""

    turn: complex = 1.0
    mirror: complex = 0.0

    def __call__(self, z: Complex) -> Complex:
        if not self.mirror:
            return np.asarray(self.turn * z)
        return np.asarray(self.turn * z + self.mirror * z.conj())

    def after(self, first: Linear) -> Linear:
        """Return the map that applies `first` and then this map."""
        return Linear(
            self.turn * first.turn + self.mirror * first.mirror.conjugate(),
            self.turn * first.mirror + self.mirror * first.turn.conjugate(),
        )


SAME = Linear()


def _from_matrix(matrix: Array) -> Linear:
    """Return the map for a matrix that acts on (α, β)."""
    (a, b), (c, d) = matrix
    return Linear(complex(a + d, c - b) / 2, complex(a - d, c + b) / 2)


def _from_two_phases(measured: str) -> Array:
    """Return the matrix from two phases, for example "ab", to αβ; the three phases sum to zero."""
    unit = dict(zip((f"i_{phase}" for phase in measured), np.eye(2), strict=True))
    return clarke(*three_phases(unit, PHASE_CURRENTS)).T


@dataclass(frozen=True)
class Mistake:
    """A mistake and its correction.

    Attributes
    ----------
    kind : str
        Mistakes of the same kind exclude one another.
    words : str
        The mistake and the remedy, as text.
    current, voltage : Linear
        Correction of the vectors.
    lag : int
        Samples to add to the lag.
    resistance, inductance, flux : float
        Parameters that fit after the correction, relative to the machine file. Voltages u/s and
        currents i/c fulfil the relation with R c/s, L c/s and ψ/s.
    loose : tuple of float
        Direction of an unknown common factor in (ln R, ln L, ln ψ).
    """

    kind: str
    words: str
    current: Linear = SAME
    voltage: Linear = SAME
    lag: int = 0
    resistance: float = 1.0
    inductance: float = 1.0
    flux: float = 1.0
    loose: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def only_flux(self) -> bool:
        """Whether the mistake concerns only the magnet flux."""
        others = (self.resistance, self.inductance, *self.loose[:2])
        return others == (1.0, 1.0, 0, 0) and (self.flux != 1.0 or self.loose[2] != 0)

    @property
    def arrangement(self) -> tuple[Linear, Linear, int]:
        """The corrections of the vectors and of the lag."""
        return self.current, self.voltage, self.lag

    def prior(self, inverter: float) -> Prior:
        """Return the prior of the parameters.

        `inverter` is the machine file's inverter voltage divided by the log's voltage.
        """
        factors = np.array([self.resistance, self.inductance, self.flux])
        direction = np.array([*self.loose, 0.0])
        covariance = np.diag(SPREAD**2) + WIDE**2 * np.outer(direction, direction)
        return Prior(
            np.asarray(np.append(np.log(factors), inverter), float),
            np.asarray(np.linalg.inv(covariance), float),
        )


AS_GIVEN = Mistake("", "as given")
_2, _3, _P = float(np.sqrt(2)), float(np.sqrt(3)), float(np.sqrt(1.5))


def _rotation(degrees: float) -> complex:
    return complex(np.exp(1j * np.radians(degrees)))


def _wrong_scale(words: str, voltage: float = 1.0, current: float = 1.0) -> Mistake:
    """Return the mistake of a wrong scale: voltages and currents too large by these factors."""
    ratio = voltage / current
    return Mistake("scale", words, resistance=ratio, inductance=ratio, flux=voltage)


#: Negated voltages fit equally well: the relation also holds for a flux turned by half a turn.
SIGN = [
    Mistake(
        "sign",
        "currents and voltages have opposite signs (scale the current by -1; but if the voltage is "
        "negated, for example by inverted duties, scale the voltage, because otherwise the angle "
        "is off by half a turn)",
        Linear(-1.0),
    )
]


def inverted_sensors(measured: str) -> list[Mistake]:
    """Return two mistakes: the first or second of two current sensors, e.g. "ab", is inverted."""
    mistakes, from_phases = [], _from_two_phases(measured)
    for phase, inverted in zip(measured, (np.diag([-1, 1]), np.diag([1, -1])), strict=True):
        message = f"i_{phase} has the opposite sign (--scale i_{phase}=-1)"
        mistakes.append(
            Mistake(
                "sign", message, _from_matrix(from_phases @ inverted @ np.linalg.inv(from_phases))
            )
        )
    return mistakes


PHASES = [
    Mistake("phases", f"the current's {words}", Linear(0.0, turn) if mirrored else Linear(turn))
    for words, mirrored, turn in (
        ("phases b and c are exchanged", True, 1.0),
        ("phases a and b are exchanged", True, _rotation(120)),
        ("phases a and c are exchanged", True, _rotation(-120)),
        ("phases are shifted by one (b c a)", False, _rotation(-120)),
        ("phases are shifted by one (c a b)", False, _rotation(120)),
        ("α and β are exchanged", True, _rotation(90)),
    )
]
LAG = [Mistake("lag", signed(lag), lag=lag) for lag in LAGS if lag]
FRAME = [
    Mistake(
        "frame",
        "phases a and b were read as α and β (--frame abc)",
        _from_matrix(_from_two_phases("ab")),
        _from_matrix(_from_two_phases("ab")),
    ),
    Mistake(
        "frame",
        "the currents of phases a and b were read as α and β",
        _from_matrix(_from_two_phases("ab")),
    ),
]
#: Mistakes with voltages that were read as u_ab and u_bc.
NEUTRAL = [
    Mistake(
        "scale",
        "voltages are those of phases a and b to neutral (--frame abc --column u_a=… u_b=…)",
        voltage=Linear(np.sqrt(3) * _rotation(30)),
    )
]
#: Currents of a delta's windings: i_a = i_ab - i_ca lags i_ab by 30° and is √3 times as large.
DELTA = [
    Mistake(
        "scale",
        "currents are those of the delta's windings, i_ab i_bc i_ca (log i_a = i_ab - i_ca and so "
        "on)",
        Linear(np.sqrt(3) * _rotation(-30)),
    ),
    Mistake(
        "scale",
        "currents are those of the delta's windings, i_ac i_ba i_cb (log i_a = i_ac - i_ba and so "
        "on)",
        Linear(np.sqrt(3) * _rotation(30)),
    ),
]
#: Line voltages u_ab, u_bc, u_ca lead the phase voltages by 30° and are √3 times as large.
LINE = [
    Mistake(
        "scale",
        "voltages are line to line, u_ab u_bc u_ca (--frame line)",
        voltage=Linear(_rotation(-30) / _3),
    ),
    Mistake(
        "scale",
        "voltages are line to line, u_ac u_ba u_cb (--frame line; they are -u_ca -u_ab -u_bc)",
        voltage=Linear(_rotation(30) / _3),
    ),
]
SCALES = [
    _wrong_scale("voltages are line to line (--frame line, or divide by √3)", voltage=_3),
    _wrong_scale("voltages are rms values (multiply by √2)", voltage=1 / _2),
    _wrong_scale("currents are rms values (multiply by √2)", current=1 / _2),
    _wrong_scale("voltages and currents are rms values (multiply both by √2)", 1 / _2, 1 / _2),
    _wrong_scale("vectors are power-invariant (multiply voltages and currents by √(2/3))", _P, _P),
    _wrong_scale("voltages alone are power-invariant (multiply by √(2/3))", voltage=_P),
    _wrong_scale("currents alone are power-invariant (multiply by √(2/3))", current=_P),
    Mistake("scale", "R_s in the machine file is line to line (halve it)", resistance=0.5),
    Mistake("scale", "R_s in the machine file is half the phase's R_s (double it)", resistance=2),
    Mistake(
        "scale",
        "R_s and inductances in the machine file are line to line (halve them)",
        resistance=0.5,
        inductance=0.5,
    ),
    Mistake("scale", "psi_f in the machine file is an rms value (multiply by √2)", flux=_2),
    Mistake("scale", "psi_f in the machine file is line to line (divide by √3)", flux=1 / _3),
]
#: A value in the machine file is wrong by an unknown factor.
FILE = [
    Mistake("scale", "psi_f in the machine file is wrong", loose=(0, 0, 1)),
    Mistake("scale", "R_s in the machine file is wrong", loose=(1, 0, 0)),
    Mistake("scale", "the inductances in the machine file are wrong", loose=(0, 1, 0)),
]
#: The scale of the log is wrong by an unknown factor.
FACTOR = [
    Mistake("scale", "the scale of the currents is wrong", loose=(1, 1, 0)),
    Mistake("scale", "the scale of the voltages is wrong", loose=(1, 1, 1)),
]
RIGHT = {
    "sign": "the current's sign is right: positive into the machine",
    "phases": "currents and voltages have the same phase order",
    "lag": "as given",
    "frame": "vectors are in the given frame",
    "scale": "scales are as given",
}
KINDS = tuple(RIGHT)


def combine(first: Mistake, second: Mistake) -> Mistake:
    """Combine two mistakes into one, with the kind and the text of `second`."""
    return replace(
        second,
        current=second.current.after(first.current),
        voltage=second.voltage.after(first.voltage),
        lag=first.lag + second.lag,
        resistance=first.resistance * second.resistance,
        inductance=first.inductance * second.inductance,
        flux=first.flux * second.flux,
        loose=second.loose if any(second.loose) else first.loose,
    )
