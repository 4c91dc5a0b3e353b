"""Build a campaign's observers for the machine that they assume; run them over many records."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from numpy.typing import NDArray

from ..comparison.cages import entries_for
from ..comparison.catalogue import Entry, Setting
from ..comparison.scenarios import believed_machine
from ..core.arrays import Array
from ..core.validation import nearest
from ..errors import UsageError
from ..estimation.columns import joined_rows
from ..estimation.passes import Passes
from ..logs.read import read_log
from ..machines import RotatingMachine, as_machine, rotating
from ..observers import AdaptiveEstimate, AdaptiveObserver, LeastSquaresObserver
from ..observers.unknowns import AUTO
from .drives import Cell
from .specification import ADAPTIVE, PLAIN, WHOLE_LOG, ObserverTable

#: Share of the rated speed above which observers without a validity flag are trusted, as in
#: firmware. An open-loop start usually accelerates the current vector to twice this speed.
TRUSTED = 0.05
#: Unknowns of the adaptive observer, unless its table names others.
UNKNOWNS = ("drift", "resistance", "inverter")
#: Number of records that the plain observer runs at once; more would need too much memory.
TOGETHER = 16
#: Default current noise that observers assume, as a share of the rated current. Equals the plain
#: observer's default.
NOISE = 0.002


class ObservedRecord(NamedTuple):
    """Estimates of an observer on one record; shape (rows,). Without a stated std, it is None.

    `errors` maps parameters to their errors on the last valid row, in standard deviations.
    """

    theta_e: Array
    speed_e: Array
    valid: NDArray[np.bool_]
    theta_e_std: Array | None
    errors: dict[str, float]


class Parameters(NamedTuple):
    """True parameters of a drive: R_s [Ω], psi_f [Wb], voltage lost per inverter phase [V]."""

    resistance: float
    psi_f: float
    inverter_voltage: float


@dataclass(frozen=True)
class WholeLogEstimate:
    """The estimate of every row of a record.

    Parameters
    ----------
    machine : RotatingMachine
        The machine file.
    sample_time : float
        [s].
    """

    machine: RotatingMachine
    sample_time: float

    def run(self, voltage: Array, current: Array) -> ObservedRecord:
        """Estimate a record; the voltage of a row is the mean over the interval before it."""
        log = read_log((voltage, current), sample_time=self.sample_time, lag=1)
        passes = Passes.begun(log, self.machine, (AUTO,), None, {}, causal=False)
        columns = joined_rows(list(passes.rows())).columns
        return ObservedRecord(
            columns["theta_e"],
            columns["speed_e"],
            np.asarray(columns["valid"], bool),
            columns["theta_e_std"],
            {},
        )


@dataclass(frozen=True, eq=False)
class Candidate:
    """An observer of a campaign, ready to run.

    Attributes
    ----------
    table : ObserverTable
    believed : RotatingMachine
        The machine that the observer assumes.
    observer
        A compiled observer, or an observer that steps in JAX.
    trusted : float
        Electrical speed above which an observer without a validity flag is trusted [rad/s].
    """

    table: ObserverTable
    believed: RotatingMachine
    observer: Any
    trusted: float

    @property
    def compiled(self) -> bool:
        """Whether this is a compiled observer, which flags its valid rows."""
        return self.table.kind in (PLAIN, ADAPTIVE, WHOLE_LOG)

    @property
    def adaptive(self) -> bool:
        return self.table.kind == ADAPTIVE


def candidate(table: ObserverTable, cell: Cell, noise: float) -> Candidate:
    """Build an observer for the machine of a nominal drive.

    Parameters
    ----------
    noise : float
        Current noise that the observer assumes [A].

    Raises
    ------
    FluxobsError
        This machine has no such observer, or the observer has no such gain.
    """
    believed = _believed(table, cell)
    observer = _build_observer(table, believed, cell, noise)
    return Candidate(table, believed, observer, TRUSTED * cell.rated.speed_e)


def _believed(table: ObserverTable, cell: Cell) -> RotatingMachine:
    """Return the machine that an observer assumes."""
    machine = rotating(as_machine(table.file), "a campaign") if table.file else cell.machine
    return believed_machine(machine, table.machine)


def _build_observer(
    table: ObserverTable, believed: RotatingMachine, cell: Cell, noise: float
) -> Any:
    h = cell.rated.sample_time
    settings: dict[str, Any] = {
        "sample_time": h,
        "memory": table.memory,
        "current_noise": noise,
        "rated_current": cell.current,
    }
    if table.kind == WHOLE_LOG:
        return WholeLogEstimate(believed, h)
    if table.kind == PLAIN:
        return LeastSquaresObserver.for_machine(believed, **settings)
    if table.kind == ADAPTIVE:
        unknowns = table.unknowns or UNKNOWNS
        return AdaptiveObserver.for_machine(
            believed, unknowns=unknowns, dc_link=cell.rated.dc_link, **settings
        )
    setting = _setting(believed, cell, noise)
    entry = check_observer(table, cell)
    assert entry is not None
    return entry.build(setting, entry.recommended(setting) | (table.gains or {}))


def check_observer(table: ObserverTable, cell: Cell) -> Entry | None:
    """Return the catalogue's entry of an observer; None for a compiled observer.

    Raises
    ------
    FluxobsError
        This machine has no such observer, or the observer has no such gain or unknown.
    """
    if table.kind in (PLAIN, ADAPTIVE, WHOLE_LOG):
        _build_observer(table, _believed(table, cell), cell, NOISE * cell.current)
        return None
    entries = {entry.name: entry for entry in entries_for(cell.machine) if not entry.least_squares}
    if table.kind not in entries:
        kinds = (PLAIN, ADAPTIVE, WHOLE_LOG, *entries)
        raise UsageError(
            f"observers: {cell.name} has no {table.kind!r}{nearest(table.kind, kinds)}"
        )
    if table.gains:
        gains = entries[table.kind].recommended(_setting(cell.machine, cell, NOISE * cell.current))
        for name in table.gains:
            if name not in gains:
                raise UsageError(
                    f"observers: {table.kind} has no gain {name!r}{nearest(name, gains)}"
                )
    return entries[table.kind]


def _setting(believed: RotatingMachine, cell: Cell, noise: float) -> Setting:
    voltage, current = nominal_record(cell)
    return Setting(
        believed,
        cell.rated.sample_time,
        cell.rated.speed_e,
        cell.current,
        cell.voltage,
        noise,
        None,
        voltage,
        current,
    )


@lru_cache(maxsize=4)
def nominal_record(cell: Cell) -> tuple[Array, Array]:
    """Return (voltage, current) of the nominal drive; shape (rows, 2) each.

    The record contains a ramp to half speed, a load step and a reversal. The observers of the
    regression balance their gains on it.
    """
    from ..simulation.drive import Course, Profile, simulate

    rated_speed = cell.rated.speed_e / cell.machine.n_p
    course = Course(
        Profile(
            [0.0, 0.3, 0.8, 1.2], [0.0, 0.5 * rated_speed, 0.5 * rated_speed, -0.5 * rated_speed]
        ),
        cell.rated.dc_link,
        Profile([0.5, 0.5], [0.0, 0.5 * cell.rated.torque]),
    )
    record = simulate(cell.nominal, course, 1.5).record()
    return np.nan_to_num(record.interval_voltage()), record.current


def observe(
    candidate: Candidate, voltage: Array, current: Array, true_parameters: Sequence[Parameters]
) -> Iterator[ObservedRecord]:
    """Run an observer over records; shape (lanes, rows, 2). Yield the results lane by lane.

    The voltage of row k is the mean over the interval that ends at row k; the first voltage is NaN.
    """
    if not candidate.compiled:
        outputs = _run_in_jax(candidate.observer, np.nan_to_num(voltage), current)
        for theta, speed in zip(*map(np.asarray, outputs), strict=True):
            yield ObservedRecord(theta, speed, np.abs(speed) > candidate.trusted, None, {})
        return
    if candidate.table.kind == WHOLE_LOG:
        for u, i in zip(voltage, current, strict=True):
            yield candidate.observer.run(u, i)
        return
    if not candidate.adaptive:
        for first in range(0, len(voltage), TOGETHER):
            together = slice(first, first + TOGETHER)
            # One thread: the campaign has a process per core.
            batch = candidate.observer.run(voltage[together], current[together], threads=1)
            lanes = (batch.theta_e, batch.speed_e, batch.valid, batch.theta_e_std)
            for theta_e, speed_e, valid, std in zip(*lanes, strict=True):
                yield ObservedRecord(theta_e, speed_e, valid, std, {})
        return
    # One record at a time: all at once would take a gigabyte.
    for u, i, parameters in zip(voltage, current, true_parameters, strict=True):
        estimate = candidate.observer.run(u, i)
        errors = _errors(candidate, estimate, parameters)
        yield ObservedRecord(
            estimate.theta_e, estimate.speed_e, estimate.valid, estimate.theta_e_std, errors
        )


@eqx.filter_jit
def _run_in_jax(observer: Any, voltage: Array, current: Array) -> Any:
    def lane(voltage: Any, current: Any) -> Any:
        def body(state: Any, row: Any) -> Any:
            state, estimate = observer.step(state, *row)
            return state, (estimate.theta_e, estimate.speed_e)

        return jax.lax.scan(body, observer.init(), (voltage, current))[1]

    return jax.vmap(lane)(voltage, current)


def _errors(
    candidate: Candidate, estimate: AdaptiveEstimate, true_parameters: Parameters
) -> dict[str, float]:
    """Return the parameter errors [std] on the last valid row; empty without a valid row."""
    names = ["resistance", "inverter_voltage"]
    if candidate.believed.magnets and not candidate.believed.flux_moves:
        names.append("psi_f")
    valid_rows = np.flatnonzero(estimate.valid)
    if not len(valid_rows):
        return {}
    row, errors = valid_rows[-1], {}
    for name in names:
        std = float(getattr(estimate, f"{name}_std")[row])
        if std > 0:
            errors[name] = (
                float(getattr(estimate, name)[row]) - getattr(true_parameters, name)
            ) / std
    return errors
