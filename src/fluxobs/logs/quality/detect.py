"""Find faulty rows from the signals alone.

Each detector needs a contrast that a good log cannot have: bit-identical rows although noise or
rotation changes the others, a flat top although the current enters and leaves it with a slope. So
quantised, noise-free, filtered and resting signals carry no marks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...core.arrays import Array, runs
from ...machines.model.frames import wrap
from ..time.aligned import Aligned
from .floating import commutating, floating_phase
from .marks import (
    CLIPPED,
    HELD,
    INJECTED,
    MISSING,
    NO_CURRENT,
    NO_MEASUREMENT,
    OUTLIER,
    RANGE,
    REPEATED,
    with_floating,
)
from .noise import injected
from .outliers import outliers

Flags = NDArray[np.bool_]

#: A current or a voltage beyond this multiple of its usual size is out of range. At low speed the
#: voltages of a load step are twenty times the usual ones.
PLAUSIBLE, PLAUSIBLE_VOLTAGE = 10.0, 100.0
#: Rows at the start without a voltage are normal.
FIRST_ROWS = 3
#: Expected number of false marks in a batch.
FALSE_MARKS = 1e-3
#: Rows on each side that give the usual step of a current.
STEP_ROWS = 64
#: Fewest changes of a component on each side.
LEAST_STEPS = 16
#: Changes below this share of the current are rounding errors of a conversion.
ROUNDING = 1e-9
#: The voltages of a repeated row act up to this many rows later.
LATE_ROWS = 3
#: Values within this share of the extreme equal it: text with five decimals rounds them apart.
LEVEL_SHARE = 2e-5
#: Fewest rows of a flat top, and of all of them.
FLAT_ROWS, FLAT_TOTAL = 3, 10
#: The slopes at the ends of a flat top predict a peak above it by this multiple of its tolerance.
OVERSHOOT = 5.0
#: No current: below this share of the usual one, for this many rows.
IDLE_SHARE, IDLE_ROWS = 0.02, 20
#: Largest share, whatever the noise.
MOST_IDLE = 0.1
#: Currents are bridged while they turn by less than this [rad].
LONGEST_BRIDGE = 3.0
#: Most rows before a gap that tell how fast the current turns.
TURN_ROWS = 8
SIN_120 = 3**0.5 / 2


@dataclass(frozen=True)
class Detector:
    """Detectors for a log with these usual sizes.

    Parameters
    ----------
    current, voltage : float
        Usual sizes [A], [V].
    noise : float
        Standard deviation of a current component [A].
    """

    current: float
    voltage: float
    noise: float

    def marked(self, rows: Aligned) -> Aligned:
        """Return rows with marks, and without the values that the marks exclude."""
        marks = self.marks(rows)
        current = np.where((marks & NO_MEASUREMENT > 0)[:, None], np.nan, rows.current)
        voltage = np.where(self._stale(rows, marks)[:, None], np.nan, rows.voltage)
        return rows._replace(current=bridged(current), voltage=voltage, marks=marks)

    def smooth(self, rows: Aligned) -> Array:
        """Return the currents, NaN where they are no measurements or commutate."""
        marks = self.marks(rows)
        rough = marks & NO_MEASUREMENT > 0
        phase = floating_phase(rows.current, None, self.idle_limit)
        if phase.any():
            rough |= commutating(rows.current, phase, self.idle_limit)
        return np.where(rough[:, None], np.nan, rows.current)

    @property
    def idle_limit(self) -> float:
        """Largest current of a phase or machine without current [A]."""
        return min(IDLE_SHARE * self.current + 4 * self.noise, MOST_IDLE * self.current)

    def marks(self, rows: Aligned) -> NDArray[np.int64]:
        """Return the sum of the marks of each row."""
        current, voltage = rows.current, rows.voltage
        known = np.asarray(np.isfinite(current).all(axis=1))
        known_voltage = np.asarray(np.isfinite(voltage).all(axis=1))
        known_voltage[:FIRST_ROWS] = True  # the lag decides where the first interval ends
        size, u = _size(current), _size(voltage)
        large = size >= PLAUSIBLE * self.current
        large_voltage = u >= PLAUSIBLE_VOLTAGE * self.voltage
        repeated, held = self._repeated(current, voltage, known)
        clipped = self._clipped(current, known & ~large)
        clipped |= held & _at_extreme(current, known & ~large)
        outlier = outliers(current, self.current) & known & ~large
        finite = np.where((known & ~large)[:, None], current, np.nan)
        idle = _long(known & (size < self.idle_limit), IDLE_ROWS)
        marks = np.zeros(len(current), np.int64)
        for flags, mark in (
            (~known | ~known_voltage, MISSING),
            (repeated, REPEATED),
            (held & ~clipped, HELD),
            (clipped, CLIPPED),
            (large | large_voltage, RANGE),
            (outlier, OUTLIER),
            (idle, NO_CURRENT),
            (injected(finite, self.current), INJECTED),
        ):
            marks = marks + mark * flags
        return with_floating(marks, floating_phase(current, voltage, self.idle_limit))

    def _stale(self, rows: Aligned, marks: NDArray[np.int64]) -> Flags:
        """Return the intervals whose voltage is repeated or out of range."""
        stale = _size(rows.voltage) >= PLAUSIBLE_VOLTAGE * self.voltage
        same = _same_as_before(rows.voltage)
        for start, end in runs(np.asarray(marks & REPEATED > 0)):
            late = min(end + LATE_ROWS, len(stale))
            stale[start:late] |= same[start:late]
        return np.asarray(stale)

    def _repeated(self, current: Array, voltage: Array, known: Flags) -> tuple[Flags, Flags]:
        """Return the rows that repeat a row, and those that hold only its current."""
        none = np.zeros(len(current), bool)
        if len(current) < 2:
            return none, none
        with np.errstate(over="ignore", invalid="ignore"):
            change = np.abs(np.diff(current, axis=0))
        same = np.concatenate([[False], (change == 0).all(axis=1)])
        same &= known & (current != 0).any(axis=1)
        if not same.any():
            return none, none
        moved = change[np.isfinite(change) & (change > ROUNDING * self.current)]
        if not len(moved):
            return none, none
        resolution = float(moved.min())
        same_voltage = _same_as_before(voltage)
        repeated, held = none.copy(), none.copy()
        steps = np.where(change > 0, change, np.nan)
        for start, end in runs(same):
            before = steps[max(0, start - STEP_ROWS) : start - 1]
            after = steps[end : end + STEP_ROWS]  # the step that leaves the run is at end - 1
            sides = [side[np.isfinite(side)] for side in (before, after)]
            if min(len(side) for side in sides) < LEAST_STEPS:
                continue  # the signal rests
            spread = float(np.median(np.concatenate(sides)))
            leaves = steps[end - 1] if end <= len(steps) - 1 else np.zeros(2)
            if not np.nanmax(np.nan_to_num(leaves)) > spread / 2:
                continue  # it starts to move from rest
            chance = min(1.0, resolution / spread) ** (2 * (end - start))
            if chance * len(current) > FALSE_MARKS:
                continue
            late = min(end + LATE_ROWS, len(current))
            stands = same_voltage[start:late].sum() >= end - start - 1
            (repeated if stands and end - start > 1 else held)[start:end] = True
        return repeated, held

    def _clipped(self, current: Array, known: Flags) -> Flags:
        """Return the rows of which a phase is at its extreme, and their neighbours."""
        at_limit = np.zeros(len(current), bool)
        for phase in _phases(current):
            for signed in (phase, -phase):
                at_limit |= _flat_top(np.where(known, signed, -np.inf))
        padded = np.concatenate([[False], at_limit, [False]])
        return np.asarray((padded[:-2] | at_limit | padded[2:]) & known)


def _phases(current: Array) -> tuple[Array, Array, Array]:
    alpha, beta = current[:, 0], current[:, 1]
    return alpha, -alpha / 2 + SIN_120 * beta, -alpha / 2 - SIN_120 * beta


def _at_extreme(current: Array, known: Flags) -> Flags:
    """Return the rows of which a phase has its largest or smallest value."""
    result = np.zeros(len(current), bool)
    for phase in _phases(current):
        for signed in (phase, -phase):
            values = np.where(known, signed, -np.inf)
            most = float(values.max(initial=0.0))
            result |= values >= most * (1 - LEVEL_SHARE)
    return np.asarray(result & known)


def _flat_top(signal: Array) -> Flags:
    """Return the rows at a level that the signal reaches with a slope and does not exceed."""
    none = np.zeros(len(signal), bool)
    most = float(signal.max(initial=0.0))
    if not most > 0:
        return none
    tolerance = LEVEL_SHARE * most
    top = signal >= most - tolerance
    if top.sum() < FLAT_TOTAL:
        return none
    sharp = 0
    for start, end in runs(top):
        rows = end - start
        if rows < FLAT_ROWS or start < rows or end + rows > len(signal):
            continue
        before = (signal[start] - signal[start - rows]) / rows
        after = (signal[end - 1] - signal[end - 1 + rows]) / rows
        levels = np.abs(np.diff(signal[start - rows : start]))
        moved = levels[np.isfinite(levels) & (levels > 0)]
        resolution = max(tolerance, float(moved.min()) if len(moved) else 0.0)
        if min(before, after) * rows / 4 > OVERSHOOT * resolution:
            sharp += rows
    return top if sharp >= FLAT_TOTAL // 2 else none


def _same_as_before(vectors: Array) -> Flags:
    return np.asarray(np.concatenate([[False], (vectors[1:] == vectors[:-1]).all(axis=1)]))


def _size(vectors: Array) -> Array:
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.hypot(vectors[:, 0], vectors[:, 1]))


def _long(flags: Flags, rows: int) -> Flags:
    """Return the runs of at least this many rows."""
    kept = np.zeros(len(flags), bool)
    for start, end in runs(flags):
        if end - start >= rows:
            kept[start:end] = True
    return kept


def bridged(current: Array) -> Array:
    """Return currents with short gaps bridged: size and angle change linearly.

    A gap is short if the vector turns by less than LONGEST_BRIDGE, judged from the rows before it.
    """
    missing = np.asarray(~np.isfinite(current).all(axis=1))
    if not missing.any():
        return current
    filled = current.copy()
    last = 0  # end of the gap before
    for start, end in runs(missing):
        known = current[max(last, start - TURN_ROWS) : start]
        last = end
        if len(known) < 2 or end >= len(current):
            continue
        turns = wrap(np.diff(np.arctan2(known[:, 1], known[:, 0])))
        rows = end - start + 1
        if abs(float(np.mean(turns))) * rows > LONGEST_BRIDGE:
            continue
        (x, y), (x1, y1) = known[-1], current[end]
        share = np.arange(1, rows) / rows
        size = np.hypot(x, y) + share * (np.hypot(x1, y1) - np.hypot(x, y))
        angle = np.arctan2(y, x) + share * wrap(np.arctan2(y1, x1) - np.arctan2(y, x))
        filled[start:end, 0] = size * np.cos(angle)
        filled[start:end, 1] = size * np.sin(angle)
    return filled
