"""How the flux of a machine depends on its current, in rotor coordinates.

A machine with the map F has the flux ``λ = e^{jφ} F(e^{-jφ} i)``. The observers ask a map for F,
its derivative J and the auxiliary flux ``a = F + j J(j i)``: an error e of the angle φ moves the
flux of a current by ``-j e a``. So ``λ - e^{jφ}(F - a_d)`` lies along d whatever small error the φ
has at which the map was asked (docs/theory.md, section 14).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...core.arrays import Array
from ...errors import ModelError

Complex = NDArray[np.complex128]

#: What a table says of each of its axes.
SPAN = ("least", "most", "over")
#: Rounds in which a map is asked at the angle that it gave: each squares the error.
ROUNDS = 6
#: Keeps a direction of nothing from being no number [Wb].
TINY = 1e-300
#: Degree of the splines: inductances are continuous, and a point of the map is made of nine
#: coefficients (of sixteen with cubic ones, whose angle is no better).
DEGREE = 2


class Mapped(NamedTuple):
    """A map at currents, each (...): flux d + j q [Wb]; its derivatives by i_d and i_q [H]."""

    flux: Complex
    by_d: Complex
    by_q: Complex

    def auxiliary(self, current: ArrayLike) -> Complex:
        """``F + j J(j i)`` [Wb]; its real part is the active flux."""
        i = np.asarray(current, complex)
        return np.asarray(self.flux + 1j * (self.by_q * i.real - self.by_d * i.imag))


class FluxMap:
    """The interface of every map. Maps are frozen; see the subclasses."""

    #: Its number in firmware/fluxobs_map.h.
    code: ClassVar[int]
    #: Whether there are magnets (or a rotor flux): F(0) is not 0.
    magnets: bool

    def at(self, current: ArrayLike) -> Mapped:
        """Flux and derivatives at currents in rotor coordinates d + j q [A], (...)."""
        raise NotImplementedError

    def flux(self, current: ArrayLike) -> Complex:
        """Flux at currents in rotor coordinates d + j q [Wb], [A], (...)."""
        return self.at(current).flux

    def position_vector(
        self, flux: ArrayLike, current: ArrayLike, L_q: float
    ) -> tuple[Complex, Complex, Complex]:
        """Position vectors λ - e^{jφ}(F - a_d) with the map asked at their own angle φ, (...).

        Parameters
        ----------
        flux, current : array_like
            α + j β [Wb], [A], (...).
        L_q : float
            Inductance with which the angle starts, from λ - L_q i [H].

        Returns
        -------
        x, i, a : complex ndarray
            Position vector, α + j β [Wb]; current [A] and auxiliary flux [Wb] in rotor coordinates.
        """
        psi, i = np.asarray(flux, complex), np.asarray(current, complex)
        x = np.asarray(psi - L_q * i, complex)
        for _ in range(ROUNDS):
            direction = x / (np.abs(x) + TINY)
            turned = i * direction.conj()
            at = self.at(turned)
            a = at.auxiliary(turned)
            x = np.asarray(psi - direction * (at.flux - a.real), complex)
        return x, turned, a

    def outside(self, current: ArrayLike) -> NDArray[np.bool_]:
        """Whether currents are outside the map's range, where it is extrapolated, (...)."""
        return np.zeros(np.shape(current), bool)

    def fields(self) -> dict[str, Any]:
        """Its fields in C: a subset of fo_map (firmware/fluxobs_map.h)."""
        raise NotImplementedError

    def core(self) -> dict[str, Any]:
        """All fields of fo_map."""
        zeros = dict.fromkeys(
            [
                "psi",
                "L_d",
                "L_q",
                "decay",
                "still",
                "ripple",
                "least_d",
                "most_d",
                "over_d",
                "least_q",
                "most_q",
                "over_q",
            ],
            0.0,
        )
        none: dict[str, Any] = {"coefficients": np.zeros((0, 0, 2))}
        return {"kind": self.code, "magnets": bool(self.magnets)} | zeros | none | self.fields()


@dataclass(frozen=True)
class LinearMap(FluxMap):
    """``psi + L_d i_d + j L_q i_q`` [Wb], [H]."""

    psi: float
    L_d: float
    L_q: float

    code: ClassVar[int] = 0

    @property
    def magnets(self) -> bool:  # type: ignore[override]
        return self.psi > 0

    def at(self, current: ArrayLike) -> Mapped:
        i = np.asarray(current, complex)
        ones = np.ones(i.shape)
        return Mapped(
            np.asarray(self.psi + self.L_d * i.real + 1j * self.L_q * i.imag),
            np.asarray(self.L_d * ones, complex),
            np.asarray(1j * self.L_q * ones),
        )

    def fields(self) -> dict[str, Any]:
        return {"psi": self.psi, "L_d": self.L_d, "L_q": self.L_q}


@dataclass(frozen=True)
class CageMap(FluxMap):
    """``psi + L_sigma i``, d along the rotor flux: ``dψ/dt = R_R i_d - R_R ψ/L_M`` is its length.

    Parameters
    ----------
    L_sigma, L_M : float
        Leakage and magnetizing inductance of the inverse-Γ model [H].
    R_R : float
        Its rotor resistance [Ω].
    sample_time : float
        [s].
    psi_R : float
        Rated rotor flux [Wb].
    still : float
        Change of i_d below which the rotor flux is taken to stand [A].
    offset : float
        Std of the currents' offsets [A]. In a drive that regulates the measured current they make
        the true i_d, and with it the rotor flux, ripple with the stator frequency ω: by
        ``R_R offset/√(ω² + (R_R/L_M)²)``, which looks like an offset of the flux.
    """

    L_sigma: float
    L_M: float
    R_R: float
    sample_time: float
    psi_R: float
    still: float
    offset: float

    code: ClassVar[int] = 2
    magnets: ClassVar[bool] = True  # type: ignore[misc]

    def at(self, current: ArrayLike) -> Mapped:
        return LinearMap(self.psi_R, self.L_sigma, self.L_sigma).at(current)

    def fields(self) -> dict[str, Any]:
        return {
            "L_d": self.L_sigma,
            "L_q": self.L_sigma,
            "decay": self.R_R * self.sample_time / self.L_M,
            "still": self.still,
            "ripple": self.R_R * self.offset / self.psi_R,
        }


@dataclass(frozen=True, eq=False)
class TableMap(FluxMap):
    """Quadratic B-splines over a grid of currents with equal steps in each direction.

    Beyond the grid the map goes on linearly, and :meth:`outside` says so.

    Parameters
    ----------
    d, q : (2,) array_like
        Range of i_d and of i_q [A].
    coefficients : (intervals along d + 2, intervals along q + 2, 2) array_like
        Of psi_d and psi_q [Wb].
    magnets : bool
    """

    d: Array
    q: Array
    coefficients: Array
    magnets: bool = field(default=True)

    code: ClassVar[int] = 1

    def __post_init__(self) -> None:
        for name in ("d", "q", "coefficients"):
            value = np.array(getattr(self, name), float)
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if self.coefficients.ndim != 3 or self.coefficients.shape[2] != 2:
            raise ModelError(f"coefficients must be (d, q, 2), got {self.coefficients.shape}")
        if min(self.coefficients.shape[:2]) < DEGREE + 1:
            raise ModelError("a table needs at least one interval along d and along q")
        if not (self.d[1] > self.d[0] and self.q[1] > self.q[0]):
            raise ModelError("a table's ranges of i_d and i_q must not be empty")
        if not np.isfinite(self.coefficients).all():
            raise ModelError("every coefficient of a table must be finite")

    @property
    def intervals(self) -> tuple[int, int]:
        """Along d and along q."""
        return self.coefficients.shape[0] - DEGREE, self.coefficients.shape[1] - DEGREE

    def at(self, current: ArrayLike) -> Mapped:
        i = np.asarray(current, complex)
        d, q = np.clip(i.real, *self.d), np.clip(i.imag, *self.q)
        c = self.coefficients[..., 0] + 1j * self.coefficients[..., 1]
        first_d, value_d, slope_d = weights(d, self.d, self.intervals[0])
        first_q, value_q, slope_q = weights(q, self.q, self.intervals[1])
        three = np.arange(DEGREE + 1)
        near = c[
            (first_d[..., None] + three)[..., :, None], (first_q[..., None] + three)[..., None, :]
        ]
        along_q = np.einsum("...dq,...q->...d", near, value_q)
        flux = np.einsum("...d,...d->...", value_d, along_q)
        by_d = np.einsum("...d,...d->...", slope_d, along_q)
        by_q = np.einsum("...d,...dq,...q->...", value_d, near, slope_q)
        return Mapped(flux + (i.real - d) * by_d + (i.imag - q) * by_q, by_d, by_q)

    def outside(self, current: ArrayLike) -> NDArray[np.bool_]:
        i = np.asarray(current, complex)
        beyond_d = (i.real < self.d[0]) | (i.real > self.d[1])
        return np.asarray(beyond_d | (i.imag < self.q[0]) | (i.imag > self.q[1]))

    @cached_property
    def psi_f(self) -> float:
        """Flux of the magnets [Wb]: that without current."""
        return float(self.flux(0j).real) if self.magnets else 0.0

    def fields(self) -> dict[str, Any]:
        over = np.array(self.intervals) / (self.d[1] - self.d[0], self.q[1] - self.q[0])
        return {
            "psi": self.psi_f,
            "least_d": self.d[0],
            "most_d": self.d[1],
            "over_d": over[0],
            "least_q": self.q[0],
            "most_q": self.q[1],
            "over_q": over[1],
            "coefficients": np.ascontiguousarray(self.coefficients),
        }


def weights(x: Array, span: Array, intervals: int) -> tuple[NDArray[np.int64], Array, Array]:
    """The first of the three splines at x within `span`, (...), their values and derivatives,
    (..., 3)."""
    over = intervals / (span[1] - span[0])
    at = (x - span[0]) * over
    first = np.clip(at.astype(np.int64), 0, intervals - 1)
    t = at - first
    u = 1 - t
    values = [u * u / 2, 1 / 2 + t * u, t * t / 2]
    slopes = [-u, u - t, t]
    return first, np.stack(values, -1), over * np.stack(slopes, -1)


def basis(x: Array, span: Array, intervals: int, derivative: int = 0) -> Array:
    """Values or derivatives of all B-splines over `span` in equal intervals, (len(x), splines)."""
    from scipy.interpolate import BSpline  # loaded only where a table is fitted

    step = (span[1] - span[0]) / intervals
    knots = span[0] + step * np.arange(-DEGREE, intervals + DEGREE + 1)
    splines = BSpline(knots, np.eye(intervals + DEGREE), DEGREE)
    return np.asarray((splines.derivative(derivative) if derivative else splines)(x))
