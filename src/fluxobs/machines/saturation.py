"""Flux maps in machine files: a table of points, or the algebraic model of saturation."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field, PlainValidator, ValidationError

from ..core.input_files import check_regular
from ..core.validation import NotNegative, Positive, complaints
from ..errors import FluxobsError, MachineError, ModelError
from .model.flux_table import FittedTable, fit_table

Complex = NDArray[np.complex128]

#: Columns of a map's file [A], [Wb].
COLUMNS = ("i_d", "i_q", "psi_d", "psi_q")
#: Largest current in a model's table, in rated currents. Few drives use more current.
RANGE = 2.0
#: Points per axis to which a model's table is fitted. There must be more points than splines.
POINTS = 61
#: Exponents of the algebraic model.
Exponent = Annotated[float, Field(ge=0, le=20, allow_inf_nan=False)]


@dataclass(frozen=True, eq=False)
class FluxPoints:
    """Points of a flux map, on a grid or scattered.

    Points with only one sign of i_q are mirrored to the other sign; without magnets, the points are
    also mirrored in i_d.

    Parameters
    ----------
    current, flux : (points,) array_like
        d + j q [A], [Wb].
    source : str
        Path of the points' file.
    """

    current: Complex
    flux: Complex
    source: str = "flux_map"

    def __post_init__(self) -> None:
        for name in ("current", "flux"):
            value = np.array(getattr(self, name), complex).ravel()
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        return f"{len(self.current)} points of {Path(self.source).name}"

    @classmethod
    def from_columns(
        cls, i_d: ArrayLike, i_q: ArrayLike, psi_d: ArrayLike, psi_q: ArrayLike
    ) -> FluxPoints:
        """Return points from four arrays of one shape [A], [Wb]."""
        d, q, flux_d, flux_q = (np.asarray(column, float) for column in (i_d, i_q, psi_d, psi_q))
        return cls(d + 1j * q, flux_d + 1j * flux_q)

    @classmethod
    def read(cls, path: str | Path) -> FluxPoints:
        """Read points from a CSV file with columns i_d, i_q [A], psi_d, psi_q [Wb].

        Raises
        ------
        MachineError
            The file cannot be read, a column is missing or a value is not a number.
        """
        check_regular(Path(path), MachineError)
        try:
            with open(path, newline="", encoding="utf-8-sig") as file:
                lines = [line for line in file if line.strip() and not line.startswith("#")]
        except OSError as error:
            raise MachineError(f"{path}: cannot be read: {error.strerror}") from None
        except UnicodeDecodeError as error:
            raise MachineError(f"{path}: not a CSV file: {error}") from None
        rows = list(csv.DictReader(lines, skipinitialspace=True))
        header = [name.strip() for name in rows[0]] if rows else []
        missing = [name for name in COLUMNS if name not in header]
        if missing:
            raise MachineError(
                f"{path}: a flux map has the columns {', '.join(COLUMNS)} [A, A, Wb, Wb]; "
                f"{', '.join(missing)} is missing"
            )
        values = np.empty((len(rows), 4))
        for k, row in enumerate(rows):
            values_by_name = {str(name).strip(): value for name, value in row.items()}
            for n, name in enumerate(COLUMNS):
                try:
                    values[k, n] = float(values_by_name[name] or "")
                except ValueError:
                    raise MachineError(
                        f"{path}: point {k + 1}: {name} is {values_by_name[name]!r}, not a number"
                    ) from None
        return cls(values[:, 0] + 1j * values[:, 1], values[:, 2] + 1j * values[:, 3], str(path))

    def table(self, rated_current: float | None, magnets: bool) -> FittedTable:
        """Fit splines to these points."""
        return fit_table(self.current, self.flux, magnets)

    def text(self) -> str:
        """Return the value of `flux_map` in a machine file."""
        return repr(self.source)


class AlgebraicSaturation(BaseModel):
    """Currents as algebraic functions of the fluxes, with cross-saturation:

        i_d = (a_d0 + a_dd |ψ_d|^S + a_dq/(V+2) |ψ_d|^U |ψ_q|^(V+2)) ψ_d - i_m
        i_q = (a_q0 + a_qq |ψ_q|^T + a_dq/(U+2) |ψ_d|^(U+2) |ψ_q|^V) ψ_q

    i_m makes i_d = 0 at the magnets' flux psi_f. The model is reciprocal for all parameters.

    Parameters
    ----------
    a_d0, a_q0 : float
        Inverse inductances without saturation [1/H], > 0.
    a_dd, a_qq, a_dq : float
        Saturation of d, of q, and cross-saturation [A/Wb^(S+1)] …, >= 0.
    S, T, U, V : float
        Exponents, 0 to 20.
    psi_f : float
        Flux of the magnets [Wb], >= 0.

    References
    ----------
    Hinkkanen, Pescetto, Mölsä, Saarakkala, Pellegrino, Bojoi, "Sensorless self-commissioning of
    synchronous reluctance motors at standstill without rotor locking", IEEE Trans. Ind. Appl. 53
    (2017), doi:10.1109/TIA.2016.2644624.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    a_d0: Positive
    a_q0: Positive
    a_dd: NotNegative = 0.0
    a_qq: NotNegative = 0.0
    a_dq: NotNegative = 0.0
    S: Exponent = 5.0
    T: Exponent = 1.0
    U: Exponent = 1.0
    V: Exponent = 0.0
    psi_f: NotNegative = 0.0

    def current(self, flux: ArrayLike) -> Complex:
        """Return the current d + j q [A] of a flux d + j q [Wb]."""
        psi = np.asarray(flux, complex)
        d, q = np.abs(psi.real), np.abs(psi.imag)
        S, T, U, V = self.S, self.T, self.U, self.V
        by_d = self.a_d0 + self.a_dd * d**S + self.a_dq / (V + 2) * d**U * q ** (V + 2)
        by_q = self.a_q0 + self.a_qq * q**T + self.a_dq / (U + 2) * d ** (U + 2) * q**V
        magnet = (self.a_d0 + self.a_dd * self.psi_f**S) * self.psi_f
        return np.asarray(by_d * psi.real - magnet + 1j * by_q * psi.imag)

    def slopes(self, flux: ArrayLike) -> tuple[NDArray[np.float64], ...]:
        """Return ∂i_d/∂ψ_d, ∂i_d/∂ψ_q = ∂i_q/∂ψ_d and ∂i_q/∂ψ_q [1/H], each (...)."""
        psi = np.asarray(flux, complex)
        d, q = np.abs(psi.real), np.abs(psi.imag)
        S, T, U, V, a = self.S, self.T, self.U, self.V, self.a_dq
        dd = self.a_d0 + (S + 1) * self.a_dd * d**S + a * (U + 1) / (V + 2) * d**U * q ** (V + 2)
        qq = self.a_q0 + (T + 1) * self.a_qq * q**T + a * (V + 1) / (U + 2) * d ** (U + 2) * q**V
        sign = np.sign(psi.real) * np.sign(psi.imag)
        return dd, sign * a * d ** (U + 1) * q ** (V + 1), qq

    def flux(self, current: ArrayLike) -> Complex:
        """Return the flux d + j q [Wb] of a current d + j q [A], computed by Newton's method.

        The map is the gradient of a convex energy, so damped steps always converge.
        """
        i = np.asarray(current, complex)
        psi = np.full(i.shape, complex(self.psi_f))
        for _ in range(200):
            error = i - self.current(psi)
            dd, dq, qq = self.slopes(psi)
            det = dd * qq - dq * dq
            step = (qq * error.real - dq * error.imag) / det + 1j * (
                (dd * error.imag - dq * error.real) / det
            )
            longest = 0.3 * (np.abs(psi) + 1 / (self.a_d0 + self.a_q0))
            psi = psi + step * np.minimum(1.0, longest / np.maximum(np.abs(step), 1e-300))
            if np.all(np.abs(step) <= 1e-13 * (1e-3 + np.abs(psi))):
                return np.asarray(psi)
        raise ModelError("the flux of a current did not converge: check the saturation parameters")

    def table(self, rated_current: float | None, magnets: bool) -> FittedTable:
        """Fit splines to points up to twice the rated current [A]."""
        if rated_current is None:
            raise MachineError("flux_map with parameters needs rated_current, which sets its range")
        if magnets != (self.psi_f > 0):
            raise MachineError(
                "flux_map: psi_f is missing, the flux of the magnets [Wb]"
                if magnets
                else "flux_map: psi_f is given, but this kind has no magnets"
            )
        axis = np.linspace(-RANGE, RANGE, POINTS) * rated_current
        i = (axis[:, None] + 1j * axis[None, :]).ravel()
        return fit_table(i, self.flux(i), magnets)

    def text(self) -> str:
        """Return the value of `flux_map` in a machine file: an inline table."""
        return "{ " + ", ".join(f"{k} = {v!r}" for k, v in self.model_dump().items()) + " }"


@dataclass(frozen=True)
class FallingInductances:
    """Inductances that fall with the current: ``L(x) = L / √(1 + k x²)``.

    x is the current divided by the rated current.

    Parameters
    ----------
    L_d, L_q : float
        Without current [H].
    rated_L_d, rated_L_q : float
        Apparent inductances at the rated current [H], not above L_d and L_q.
    psi_f : float
        [Wb].
    together : bool
        If true, x is the length of the current vector for both axes; if false, each axis uses its
        own component.
    """

    L_d: float
    L_q: float
    rated_L_d: float
    rated_L_q: float
    psi_f: float
    together: bool = False

    def table(self, rated_current: float | None, magnets: bool) -> FittedTable:
        """Fit splines to points up to twice the rated current [A]."""
        if rated_current is None:
            raise MachineError("a rated inductance (L_…_rated) needs rated_current")
        axis = np.linspace(-RANGE, RANGE, POINTS)
        x = (axis[:, None] + 1j * axis[None, :]).ravel()
        psi_dq = []
        for L, rated, component in (
            (self.L_d, self.rated_L_d, x.real),
            (self.L_q, self.rated_L_q, x.imag),
        ):
            k = (L / rated) ** 2 - 1
            square = np.abs(x) ** 2 if self.together else component**2
            psi_dq.append(L * rated_current * component / np.sqrt(1 + k * square))
        flux = self.psi_f + psi_dq[0] + 1j * psi_dq[1]
        return fit_table(x * rated_current, flux, magnets)


MapSource = FluxPoints | AlgebraicSaturation


def read_source(value: object) -> MapSource:
    """Return the map of a path or of a table of parameters; return a map unchanged."""
    if isinstance(value, FluxPoints | AlgebraicSaturation):
        return value
    if isinstance(value, str | Path):
        try:
            return FluxPoints.read(value)
        except FluxobsError as error:  # pydantic reports the message of a ValueError
            raise ValueError(str(error)) from None
    if isinstance(value, Mapping):
        names = AlgebraicSaturation.model_fields
        try:
            return AlgebraicSaturation(**value)
        except ValidationError as error:
            raise ValueError("flux_map: " + complaints(error, names, "flux_map")) from None
    raise ValueError(
        f"flux_map must be the path of a CSV file, a table of the algebraic model's parameters or "
        f"FluxPoints, got {type(value).__name__}"
    )


#: Type of a machine's field `flux_map`.
FluxMapField = Annotated[MapSource, PlainValidator(read_source)]


@lru_cache(maxsize=64)
def fitted_table(
    source: MapSource | FallingInductances, rated_current: float | None, magnets: bool
) -> FittedTable:
    """Fit the splines of a map once; copies of a machine share the fit."""
    return source.table(rated_current, magnets)


def chords(fit: FittedTable, rated_current: float | None) -> tuple[float, float, float]:
    """Return L_d, L_q [H] and psi_f [Wb] of a linear machine that approximates a map.

    The inductances are slopes of chords, over ± the rated current along q and ± half the rated
    current along d.
    """
    table = fit.table
    reach = float(min(np.abs(table.q).min(), 2 * max(np.abs(table.d))))
    i = min(rated_current or reach, reach)
    ends = np.clip(np.array([i, -i]) / 2, *table.d)
    along_d, along_q = table.flux(ends + 0j).real, table.flux(np.array([1j * i, -1j * i])).imag
    L_d = float((along_d[0] - along_d[1]) / (ends[0] - ends[1]))
    L_q = float((along_q[0] - along_q[1]) / (2 * i))
    return L_d, L_q, float(table.flux(0j).real)
