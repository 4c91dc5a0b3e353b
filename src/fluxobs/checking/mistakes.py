"""The usual mistakes with a log and a machine file: what each does to vectors and parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..core.arrays import Array
from ..machines.model.frames import PHASE_CURRENTS, clarke, three_phases
from .relation import Prior
from .segments import LAGS, Complex

#: Spread of what a machine file says: of ln R (hot copper), ln L (saturation), ln ψ (heat); of V_d,
#: which it seldom says, as a share of the voltage.
SPREAD = np.array([0.25, 0.15, 0.08, 0.1])
#: Spread of something that is wrong by an unknown factor: a thousand is two of it.
WIDE = 3.5
#: A mistake is so much less likely than none: one log in twelve has it. As twice a logarithm.
ODDS = 5.0


@dataclass(frozen=True)
class Linear:
    """z → turn · z + mirror · conj(z): any linear map of a vector."""

    turn: complex = 1.0
    mirror: complex = 0.0

    def __call__(self, z: Complex) -> Complex:
        if not self.mirror:
            return np.asarray(self.turn * z)
        return np.asarray(self.turn * z + self.mirror * z.conj())

    def after(self, first: Linear) -> Linear:
        """Both, `first` before this one."""
        return Linear(
            self.turn * first.turn + self.mirror * first.mirror.conjugate(),
            self.turn * first.mirror + self.mirror * first.turn.conjugate(),
        )


SAME = Linear()


def _linear(matrix: Array) -> Linear:
    """From a matrix that acts on (α, β)."""
    (a, b), (c, d) = matrix
    return Linear(complex(a + d, c - b) / 2, complex(a - d, c + b) / 2)


def _two(measured: str) -> Array:
    """The matrix that makes αβ of two of three phases, as "ab", whose sum is zero."""
    unit = dict(zip((f"i_{phase}" for phase in measured), np.eye(2), strict=True))
    return clarke(*three_phases(unit, PHASE_CURRENTS)).T


@dataclass(frozen=True)
class Mistake:
    """A mistake, put right.

    Attributes
    ----------
    kind : str
        Mistakes of the same kind exclude one another.
    words : str
        What was wrong, and the remedy.
    current, voltage : Linear
        What puts the vectors right.
    lag : int
        Samples to be added to the lag.
    resistance, inductance, flux : float
        What then fits, over what the machine file says. With voltages u/s and currents i/c in place
        of u and i the relation holds with R c/s, L c/s and ψ/s.
    loose : tuple of float
        What of (ln R, ln L, ln ψ) is wrong by the same unknown amount.
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
        """Whether it concerns the magnet flux alone."""
        others = (self.resistance, self.inductance, *self.loose[:2])
        return others == (1.0, 1.0, 0, 0) and (self.flux != 1.0 or self.loose[2] != 0)

    @property
    def arrangement(self) -> tuple[Linear, Linear, int]:
        """What decides the vectors."""
        return self.current, self.voltage, self.lag

    def prior(self, inverter: float) -> Prior:
        """The prior of the parameters; `inverter` is the machine file's voltage over the log's."""
        factors = np.array([self.resistance, self.inductance, self.flux])
        v = np.array([*self.loose, 0.0])
        covariance = np.diag(SPREAD**2) + WIDE**2 * np.outer(v, v)
        return Prior(
            np.asarray(np.append(np.log(factors), inverter), float),
            np.asarray(np.linalg.inv(covariance), float),
        )


AS_GIVEN = Mistake("", "as given")
_2, _3, _P = float(np.sqrt(2)), float(np.sqrt(3)), float(np.sqrt(1.5))


def _turn(degrees: float) -> complex:
    return complex(np.exp(1j * np.radians(degrees)))


def _scaled(words: str, voltage: float = 1.0, current: float = 1.0) -> Mistake:
    """Voltages and currents were given so many times too large."""
    ratio = voltage / current
    return Mistake("scale", words, resistance=ratio, inductance=ratio, flux=voltage)


#: Negated voltages do the same: the relation does not tell which, for it holds half a turn on.
SIGN = [
    Mistake(
        "sign",
        "currents and voltages have opposite signs (scale the current by -1; or the voltage if "
        "that is negated, as by inverted duties: the angle is half a turn off else)",
        Linear(-1.0),
    )
]


def one_inverted(measured: str) -> list[Mistake]:
    """One of two currents is inverted; `measured` are the phases that have a sensor, as "ab"."""
    out, two = [], _two(measured)
    for phase, inverted in zip(measured, (np.diag([-1, 1]), np.diag([1, -1])), strict=True):
        words = f"i_{phase} has the opposite sign (--scale i_{phase}=-1)"
        out.append(Mistake("sign", words, _linear(two @ inverted @ np.linalg.inv(two))))
    return out


PHASES = [
    Mistake("phases", f"the current's {words}", Linear(0.0, turn) if mirrored else Linear(turn))
    for words, mirrored, turn in (
        ("phases b and c are exchanged", True, 1.0),
        ("phases a and b are exchanged", True, _turn(120)),
        ("phases a and c are exchanged", True, _turn(-120)),
        ("phases are shifted by one (b c a)", False, _turn(-120)),
        ("phases are shifted by one (c a b)", False, _turn(120)),
        ("α and β are exchanged", True, _turn(90)),
    )
]
LAG = [Mistake("lag", f"{lag:+d}", lag=lag) for lag in LAGS if lag]
FRAME = [
    Mistake(
        "frame",
        "phases a and b were given as α and β (--frame abc)",
        _linear(_two("ab")),
        _linear(_two("ab")),
    ),
    Mistake("frame", "the currents of phases a and b were given as α and β", _linear(_two("ab"))),
]
#: Of what was read as u_ab and u_bc.
NEUTRAL = [
    Mistake(
        "scale",
        "voltages are of phases a and b to neutral (--frame abc --column u_a=… u_b=…)",
        voltage=Linear(np.sqrt(3) * _turn(30)),
    )
]
#: Line voltages u_ab, u_bc, u_ca given as phase voltages lead those by 30° and are √3 as large.
LINE = [
    Mistake(
        "scale",
        "voltages are line to line, u_ab u_bc u_ca (--frame line)",
        voltage=Linear(_turn(-30) / _3),
    ),
    Mistake(
        "scale",
        "voltages are line to line, u_ac u_ba u_cb (--frame line with these exchanged)",
        voltage=Linear(_turn(30) / _3),
    ),
]
SCALES = [
    _scaled("voltages are line to line (--frame line, or divide by √3)", voltage=_3),
    _scaled("voltages are rms values (multiply by √2)", voltage=1 / _2),
    _scaled("currents are rms values (multiply by √2)", current=1 / _2),
    _scaled("voltages and currents are rms values (multiply both by √2)", 1 / _2, 1 / _2),
    _scaled("vectors are power-invariant (multiply voltages and currents by √(2/3))", _P, _P),
    _scaled("voltages alone are power-invariant (multiply by √(2/3))", voltage=_P),
    _scaled("currents alone are power-invariant (multiply by √(2/3))", current=_P),
    Mistake("scale", "R_s in the machine file is line to line (halve it)", resistance=0.5),
    Mistake("scale", "R_s in the machine file is half of a phase's (double it)", resistance=2),
    Mistake(
        "scale",
        "R_s and inductances in the machine file are line to line (halve them)",
        resistance=0.5,
        inductance=0.5,
    ),
    Mistake("scale", "psi_f in the machine file is an rms value (multiply by √2)", flux=_2),
    Mistake("scale", "psi_f in the machine file is line to line (divide by √3)", flux=1 / _3),
]
#: A number of the machine file is wrong by an unknown factor: what fits then names it.
FILE = [
    Mistake("scale", "psi_f in the machine file is off", loose=(0, 0, 1)),
    Mistake("scale", "R_s in the machine file is off", loose=(1, 0, 0)),
    Mistake("scale", "the inductances in the machine file are off", loose=(0, 1, 0)),
]
#: And so are the log's.
FACTOR = [
    Mistake("scale", "the scale of the currents is off", loose=(1, 1, 0)),
    Mistake("scale", "the scale of the voltages is off", loose=(1, 1, 1)),
]
RIGHT = {
    "sign": "the current's sign is right: positive into the machine",
    "phases": "currents and voltages have the same phase order",
    "lag": "as given",
    "frame": "vectors are in the frame that was given",
    "scale": "scales are as given",
}
KINDS = tuple(RIGHT)


def together(one: Mistake, other: Mistake) -> Mistake:
    """Both mistakes, put right; of one kind the other replaces the one."""
    return replace(
        other,
        current=other.current.after(one.current),
        voltage=other.voltage.after(one.voltage),
        lag=one.lag + other.lag,
        resistance=one.resistance * other.resistance,
        inductance=one.inductance * other.inductance,
        flux=one.flux * other.flux,
        loose=other.loose if any(other.loose) else one.loose,
    )
