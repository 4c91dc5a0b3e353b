"""The posterior of a log: its parameters and its rows, from engine/estimate.c."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import _engine
from ..core.arrays import Array

#: Names in the order of the C code: fields of a machine file, numbers of a row and of a log.
FILE_FIELDS: tuple[str, ...] = tuple(_engine.file_fields.split())
ROW_NUMBERS: tuple[str, ...] = tuple(_engine.row_numbers.split())
LOG_NUMBERS: tuple[str, ...] = tuple(_engine.log_numbers.split())
#: Orders of the harmonics of the flux.
ORDERS: tuple[int, ...] = tuple(int(order) for order in _engine.orders.split())
#: Unknowns: parameters, then two coefficients of each harmonic.
UNKNOWNS: tuple[str, ...] = (
    *_engine.parameters.split(),
    *(f"harmonic_{order}_{part}" for order in ORDERS for part in ("d", "q")),
)
INDEX: dict[str, int] = {name: n for n, name in enumerate(UNKNOWNS)}
#: Fields of a flux map.
MAP_FIELDS: tuple[str, ...] = tuple(_engine.map_fields.split())
#: Quantities whose variance has shares: angle [rad], speed [rad/s], a component of the flux [Wb],
#: and flux × current [W s].
QUANTITIES = ("theta_e", "speed_e", "flux", "torque")
#: Names of the shares: the unknowns that change a mean, then what remains if these are exact.
SHARES: tuple[str, ...] = (*UNKNOWNS[_engine.levels :], "smoother")


@dataclass(frozen=True, eq=False)
class MachineFile:
    """A machine as the engine reads it.

    Attributes
    ----------
    numbers : dict
        The fields of fo_file (engine/estimate.h); a missing one is zero.
    map : dict, optional
        The fields of fo_map (firmware/fluxobs_map.h); None: constant inductances.
    """

    numbers: Mapping[str, float]
    map: Mapping[str, Any] | None = None


@dataclass(frozen=True, eq=False)
class Posterior:
    """What the currents of a log and the priors say.

    Attributes
    ----------
    rows : dict
        Name (engine/backward.h) → (rows,) array; the angle is NaN where nothing explains the
        currents.
    shares : (n, len(QUANTITIES), len(SHARES)) ndarray
        Shares of the variances of every `stride`-th row; zero where nothing explains it.
    stride : int
    parameters : (len(UNKNOWNS),) ndarray
        See engine/parameters.h.
    covariance : (len(UNKNOWNS), len(UNKNOWNS)) ndarray
    about : dict
        harmonics [Wb], objective, mean_square, conflict, evaluations and converged; see
        engine/posterior.h.
    """

    rows: dict[str, Array]
    shares: Array
    stride: int
    parameters: Array
    covariance: Array
    about: dict[str, float]

    def value(self, name: str) -> float:
        """Return a parameter; that of a quantity which is positive is a logarithm."""
        return float(self.parameters[INDEX[name]])

    def std(self, name: str) -> float:
        """Return the standard deviation of a parameter."""
        n = INDEX[name]
        return float(np.sqrt(self.covariance[n, n]))


def posterior_of(
    file: MachineFile,
    voltage: Array,
    current: Array,
    sample_time: float,
    hints: Array,
    sure: bool,
    start: Mapping[str, float] | None = None,
    stride: int = 1,
) -> Posterior | None:
    """Estimate a log of a synchronous or induction machine.

    Parameters
    ----------
    file : MachineFile
    voltage : (rows, 2) ndarray
        Mean from each row to the next [V]; NaN where it is missing.
    current : (rows, 2) ndarray
        [A]; NaN where it is missing.
    sample_time : float
        [s].
    hints : (rows,) ndarray
        Angles of an observer [rad]; NaN where it knows none.
    sure : bool
        Whether the observer calls them valid.
    start : mapping, optional
        Parameters from which learning starts, instead of the means of their priors.
    stride : int
        Of the rows whose variances have shares.

    Returns
    -------
    Posterior or None
        None: no parameters that a machine may have explain enough of the log.
    """
    numbers = [file.numbers.get(name, 0.0) for name in FILE_FIELDS]
    flux_map = file.map
    kind, magnets, fields, table = -1, False, np.zeros(0), np.zeros((0, 0, 0))
    if flux_map is not None:
        kind, magnets = int(flux_map["kind"]), bool(flux_map["magnets"])
        fields = np.array([flux_map[name] for name in MAP_FIELDS], float)
        table = np.ascontiguousarray(flux_map["coefficients"], float)
    begin = np.full(len(UNKNOWNS), np.nan)
    for name, value in (start or {}).items():
        begin[INDEX[name]] = value
    known, parameters, covariance, about, rows, shares = _engine.estimate(
        np.array(numbers, float),
        kind,
        magnets,
        fields,
        table,
        np.ascontiguousarray(voltage, float),
        np.ascontiguousarray(current, float),
        sample_time,
        np.ascontiguousarray(hints, float),
        sure,
        begin,
        stride,
    )
    if not known:
        return None
    columns = np.asarray(rows)
    return Posterior(
        {name: columns[:, n] for n, name in enumerate(ROW_NUMBERS)},
        np.asarray(shares),
        stride,
        np.asarray(parameters),
        np.asarray(covariance),
        dict(zip(LOG_NUMBERS, [float(value) for value in about], strict=True)),
    )
