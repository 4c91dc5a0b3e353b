"""Flux maps: flux over current, in rotor coordinates.

A machine with the map F has the flux ``λ = e^{jφ} F(e^{-jφ} i)``. The observers evaluate F, its
derivative J and the auxiliary flux ``a = F + j J(j i)``. A small error e of the angle φ moves the
flux of a current by ``-j e a``, so ``λ - e^{jφ}(F - a_d)`` lies along d in spite of that error
(docs/theory.md, section 14).
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

#: Prefixes of the fields that describe an axis of a table.
SPAN = ("least", "most", "over")
#: Iterations between a map and its angle; each iteration squares the error.
ROUNDS = 6
#: Added to a length so that the direction of a zero vector is finite [Wb].
TINY = 1e-300
#: Degree of the splines. With degree 2, inductances are continuous, and a point of the map needs
#: nine coefficients. Cubic splines need sixteen and give no better angle.
DEGREE = 2


class Mapped(NamedTuple):
    """Flux d + j q [Wb] of a map and its derivatives by i_d and i_q [H]; each has shape (...)."""

    flux: Complex
    by_d: Complex
    by_q: Complex

    def auxiliary(self, current: ArrayLike) -> Complex:
        """Return ``F + j J(j i)`` [Wb], whose real part is the active flux."""
        i = np.asarray(current, complex)
        return np.asarray(self.flux + 1j * (self.by_q * i.real - self.by_d * i.imag))


class FluxMap:
    """The interface of every flux map. Maps are immutable."""

    #: Kind of map in firmware/fluxobs_map.h.
    code: ClassVar[int]
    #: Whether F(0) is not 0, because of magnets or a rotor flux.
    magnets: bool

    def at(self, current: ArrayLike) -> Mapped:
        """Return flux and derivatives at currents d + j q [A], in rotor coordinates."""
        raise NotImplementedError

    def flux(self, current: ArrayLike) -> Complex:
        """Return the flux d + j q [Wb] at currents d + j q [A], in rotor coordinates."""
        return self.at(current).flux

    def position_vector(
        self, flux: ArrayLike, current: ArrayLike, L_q: float
    ) -> tuple[Complex, Complex, Complex]:
        """Return position vectors λ - e^{jφ}(F - a_d), whose angle is φ; shape (...).

        Parameters
        ----------
        flux, current : array_like
            α + j β [Wb], [A]; shape (...).
        L_q : float
            Inductance [H]; the iteration starts at the angle of λ - L_q i.

        Returns
        -------
        x, i, a : complex ndarray
            Position vector, α + j β [Wb]; current [A] and auxiliary flux [Wb] in rotor coordinates.
        """
        psi, i = np.asarray(flux, complex), np.asarray(current, complex)
        x = np.asarray(psi - L_q * i, complex)
        for _ in range(ROUNDS):
            direction = x / (np.abs(x) + TINY)
            i_dq = i * direction.conj()
            mapped = self.at(i_dq)
            a = mapped.auxiliary(i_dq)
            x = np.asarray(psi - direction * (mapped.flux - a.real), complex)
        return x, i_dq, a

    def outside(self, current: ArrayLike) -> NDArray[np.bool_]:
        """Return whether currents are outside the map's range, where the map is extrapolated."""
        return np.zeros(np.shape(current), bool)

    def fields(self) -> dict[str, Any]:
        """Return the fields of fo_map (firmware/fluxobs_map.h) that this map sets."""
        raise NotImplementedError

    def core(self) -> dict[str, Any]:
        """Return all fields of fo_map."""
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
        no_table: dict[str, Any] = {"coefficients": np.zeros((0, 0, 2))}
        kind = {"kind": self.code, "magnets": bool(self.magnets)}
        return kind | zeros | no_table | self.fields()


@dataclass(frozen=True)
class LinearMap(FluxMap):
    """The map ``psi + L_d i_d + j L_q i_q``, with psi in Wb and inductances in H."""

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
    """``psi + L_sigma i``; the rotor flux has the length ψ with ``dψ/dt = R_R (i_d - ψ/L_M)``.

    Parameters
    ----------
    L_sigma, L_M : float
        Leakage and magnetizing inductance of the inverse-Γ model [H].
    R_R : float
        Rotor resistance of that model [Ω].
    sample_time : float
        [s].
    psi_R : float
        Rated rotor flux [Wb].
    still : float
        Change of i_d below which the rotor flux counts as constant [A].
    offset : float
        Std of the current offsets [A]. If a drive regulates the measured current, these offsets
        make the true i_d ripple at the stator frequency ω. The rotor flux then ripples by ``R_R
        offset/√(ω² + (R_R/L_M)²)``, which looks like an offset of the flux.
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

    Beyond the grid the map is extrapolated linearly; :meth:`outside` detects this.

    Parameters
    ----------
    d, q : (2,) array_like
        Range of i_d and of i_q [A].
    coefficients : (intervals along d + 2, intervals along q + 2, 2) array_like
        Spline coefficients of psi_d and psi_q [Wb].
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
        """Number of intervals along d and along q."""
        return self.coefficients.shape[0] - DEGREE, self.coefficients.shape[1] - DEGREE

    def at(self, current: ArrayLike) -> Mapped:
        i = np.asarray(current, complex)
        d, q = np.clip(i.real, *self.d), np.clip(i.imag, *self.q)
        c = self.coefficients[..., 0] + 1j * self.coefficients[..., 1]
        first_d, value_d, slope_d = weights(d, self.d, self.intervals[0])
        first_q, value_q, slope_q = weights(q, self.q, self.intervals[1])
        offsets = np.arange(DEGREE + 1)
        local = c[
            (first_d[..., None] + offsets)[..., :, None],
            (first_q[..., None] + offsets)[..., None, :],
        ]
        along_q = np.einsum("...dq,...q->...d", local, value_q)
        flux = np.einsum("...d,...d->...", value_d, along_q)
        by_d = np.einsum("...d,...d->...", slope_d, along_q)
        by_q = np.einsum("...d,...dq,...q->...", value_d, local, slope_q)
        return Mapped(flux + (i.real - d) * by_d + (i.imag - q) * by_q, by_d, by_q)

    def outside(self, current: ArrayLike) -> NDArray[np.bool_]:
        i = np.asarray(current, complex)
        beyond_d = (i.real < self.d[0]) | (i.real > self.d[1])
        return np.asarray(beyond_d | (i.imag < self.q[0]) | (i.imag > self.q[1]))

    @cached_property
    def psi_f(self) -> float:
        """Flux of the magnets [Wb]: the flux without current."""
        return float(self.flux(0j).real) if self.magnets else 0.0

    def fields(self) -> dict[str, Any]:
        per_ampere = np.array(self.intervals) / (self.d[1] - self.d[0], self.q[1] - self.q[0])
        return {
            "psi": self.psi_f,
            "least_d": self.d[0],
            "most_d": self.d[1],
            "over_d": per_ampere[0],
            "least_q": self.q[0],
            "most_q": self.q[1],
            "over_q": per_ampere[1],
            "coefficients": np.ascontiguousarray(self.coefficients),
        }


def weights(x: Array, span: Array, intervals: int) -> tuple[NDArray[np.int64], Array, Array]:
    """Return the index of the first spline at x in `span`, and values and slopes of all three.

    The shapes are (...), (..., 3) and (..., 3).
    """
    per_unit = intervals / (span[1] - span[0])
    scaled = (x - span[0]) * per_unit
    first = np.clip(scaled.astype(np.int64), 0, intervals - 1)
    t = scaled - first
    u = 1 - t
    values = [u * u / 2, 1 / 2 + t * u, t * t / 2]
    slopes = [-u, u - t, t]
    return first, np.stack(values, -1), per_unit * np.stack(slopes, -1)


def basis(x: Array, span: Array, intervals: int, derivative: int = 0) -> Array:
    """Return B-splines over equal intervals, or their derivatives; shape (len(x), splines)."""
    from scipy.interpolate import BSpline  # imported only when a table is fitted

    step = (span[1] - span[0]) / intervals
    knots = span[0] + step * np.arange(-DEGREE, intervals + DEGREE + 1)
    splines = BSpline(knots, np.eye(intervals + DEGREE), DEGREE)
    return np.asarray((splines.derivative(derivative) if derivative else splines)(x))
