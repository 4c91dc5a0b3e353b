"""The observers of a campaign: built for a machine as they believe it, run over many records."""

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
from ..machines import RotatingMachine
from ..observers import AdaptiveEstimate, AdaptiveObserver, LeastSquaresObserver
from .drives import Cell
from .specification import ADAPTIVE, PLAIN, ObserverTable

#: Observers that do not judge themselves are trusted above this share of the rated speed, as
#: firmware does: half of the speed to which a start usually turns the current.
TRUSTED = 0.05
#: Unknowns of the adaptive observer, unless its table names others.
UNKNOWNS = ("drift", "resistance", "inverter")
#: Records that the plain observer runs at once, in lanes of the processor: more would need memory.
TOGETHER = 16
#: Current noise that observers assume, as a share of the rated current, if nothing tells it: that
#: of the plain observer.
NOISE = 0.002


class ObservedRecord(NamedTuple):
    """What an observer found on one record, (rows,) each; no std where it does not tell one.

    `errors` are those of the parameters on the last valid row, in standard deviations, by name.
    """

    theta_e: Array
    speed_e: Array
    valid: NDArray[np.bool_]
    theta_e_std: Array | None
    errors: dict[str, float]


class Parameters(NamedTuple):
    """True parameters of a drive: R_s [Ω], psi_f [Wb], loss of an inverter's phase [V]."""

    resistance: float
    psi_f: float
    inverter_voltage: float


@dataclass(frozen=True, eq=False)
class Candidate:
    """An observer of a campaign, built.

    Attributes
    ----------
    table : ObserverTable
    believed : RotatingMachine
    observer
        A compiled observer, or one that steps in JAX.
    trusted : float
        Electrical speed above which one that does not judge itself is trusted [rad/s].
    """

    table: ObserverTable
    believed: RotatingMachine
    observer: Any
    trusted: float

    @property
    def compiled(self) -> bool:
        """Whether it is one of the compiled observers, which judge themselves."""
        return self.table.kind in (PLAIN, ADAPTIVE)

    @property
    def adaptive(self) -> bool:
        return self.table.kind == ADAPTIVE


def candidate(table: ObserverTable, cell: Cell, noise: float) -> Candidate:
    """Build an observer for the nominal machine of a cell.

    Parameters
    ----------
    noise : float
        Current noise that it assumes [A].

    Raises
    ------
    FluxobsError
        No such observer for this machine, or a gain that it does not have.
    """
    believed = believed_machine(cell.machine, table.machine)
    built = _built(table, believed, cell, noise)
    return Candidate(table, believed, built, TRUSTED * cell.rated.speed_e)


def _built(table: ObserverTable, believed: RotatingMachine, cell: Cell, noise: float) -> Any:
    h = cell.rated.sample_time
    usual: dict[str, Any] = {
        "sample_time": h,
        "memory": table.memory,
        "current_noise": noise,
        "rated_current": cell.current,
    }
    if table.kind == PLAIN:
        return LeastSquaresObserver.for_machine(believed, **usual)
    if table.kind == ADAPTIVE:
        unknowns = table.unknowns or UNKNOWNS
        return AdaptiveObserver.for_machine(
            believed, unknowns=unknowns, dc_link=cell.rated.dc_link, **usual
        )
    setting = _setting(believed, cell, noise)
    entry = check_observer(table, cell)
    assert entry is not None
    return entry.build(setting, entry.recommended(setting) | (table.gains or {}))


def check_observer(table: ObserverTable, cell: Cell) -> Entry | None:
    """The catalogue's entry of an observer; None of the compiled ones.

    Raises
    ------
    FluxobsError
        There is no such observer for this machine, or it has no such gain or unknown.
    """
    if table.kind in (PLAIN, ADAPTIVE):
        _built(table, believed_machine(cell.machine, table.machine), cell, NOISE * cell.current)
        return None
    entries = {one.name: one for one in entries_for(cell.machine) if not one.least_squares}
    if table.kind not in entries:
        known = (PLAIN, ADAPTIVE, *entries)
        raise UsageError(
            f"observers: {cell.name} has no {table.kind!r}{nearest(table.kind, known)}"
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
    """Voltage and current of the nominal drive, (rows, 2) each, on which the regression's observers
    balance their gains: to half speed, load, reversal."""
    from ..simulation.drive import Course, Profile, simulate

    top = cell.rated.speed_e / cell.machine.n_p
    course = Course(
        Profile([0.0, 0.3, 0.8, 1.2], [0.0, 0.5 * top, 0.5 * top, -0.5 * top]),
        cell.rated.dc_link,
        Profile([0.5, 0.5], [0.0, 0.5 * cell.rated.torque]),
    )
    record = simulate(cell.nominal, course, 1.5).record()
    return np.nan_to_num(record.interval_voltage()), record.current


def observe(
    one: Candidate, voltage: Array, current: Array, true: Sequence[Parameters]
) -> Iterator[ObservedRecord]:
    """Run an observer over records of equal length, (lanes, rows, 2) each; yields lane by lane.

    Row k's voltage is the mean over the interval that ends there; the first is NaN.
    """
    if not one.compiled:
        outputs = _stepped(one.observer, np.nan_to_num(voltage), current)
        for theta, speed in zip(*map(np.asarray, outputs), strict=True):
            yield ObservedRecord(theta, speed, np.abs(speed) > one.trusted, None, {})
        return
    if not one.adaptive:
        for first in range(0, len(voltage), TOGETHER):
            some = slice(first, first + TOGETHER)
            all_of = one.observer.run(voltage[some], current[some], threads=1)  # of this process
            lanes = (all_of.theta_e, all_of.speed_e, all_of.valid, all_of.theta_e_std)
            for theta_e, speed_e, valid, std in zip(*lanes, strict=True):
                yield ObservedRecord(theta_e, speed_e, valid, std, {})
        return
    for u, i, parameters in zip(voltage, current, true, strict=True):  # all at once: a gigabyte
        found = one.observer.run(u, i)
        errors = _errors(one, found, parameters)
        yield ObservedRecord(found.theta_e, found.speed_e, found.valid, found.theta_e_std, errors)


@eqx.filter_jit
def _stepped(observer: Any, voltage: Array, current: Array) -> Any:
    def lane(voltage: Any, current: Any) -> Any:
        def body(state: Any, row: Any) -> Any:
            state, out = observer.step(state, *row)
            return state, (out.theta_e, out.speed_e)

        return jax.lax.scan(body, observer.init(), (voltage, current))[1]

    return jax.vmap(lane)(voltage, current)


def _errors(one: Candidate, found: AdaptiveEstimate, true: Parameters) -> dict[str, float]:
    """Errors of the parameters that the observer learns, if a row is valid."""
    names = ["resistance", "inverter_voltage"]
    if one.believed.magnets and not one.believed.flux_moves:
        names.append("psi_f")
    valid = np.flatnonzero(found.valid)
    if not len(valid):
        return {}
    last, out = valid[-1], {}
    for name in names:
        std = float(getattr(found, f"{name}_std")[last])
        if std > 0:
            out[name] = (float(getattr(found, name)[last]) - getattr(true, name)) / std
    return out
