"""Rows of a log with the angles of an observer, prepared for the smoother."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array, runs
from ..core.output import ahead
from ..logs.quality.marks import BRIDGE_OFF, NO_CURRENT
from ..logs.time.aligned import Aligned, between, joined, less_lost
from ..machines.model.frames import wrap
from ..machines.model.inverter import InverterError
from ..observers import Estimate
from ..observers.for_log import Prepared
from ..smoothing.record import RecordSamples
from .lag import shifted

#: Anchors: if fewer rows than this share are valid, rows with a larger standard deviation anchor
#: too [rad].
FEW_ANCHORS, POOR_ANCHOR_STD = 0.05, np.radians(12.0)
#: Percentile of the speed that counts as usual.
USUAL = 95
#: Intervals behind a bridge that was off, whose voltages may still be wrong.
LATE_INTERVALS = 2
#: Gaps of at most this many voltages are interpolated.
SHORT_GAP = 2


@dataclass(frozen=True, eq=False)
class Anchored:
    """Rows of a log with the estimates of an observer."""

    samples: Aligned
    angle: Array
    angle_std: Array
    valid: NDArray[np.bool_]


def forwards(
    run: Prepared, state: Any, first: int | None = None, last: int | None = None
) -> Iterator[tuple[Any, Anchored]]:
    """Run the observer forwards over rows of a log; yield its state and the rows."""
    observer: Any = run.observer
    for batch in ahead(run.aligned(first, last)):
        state, estimates = observer.resume(state, batch.voltage, batch.current)
        yield state, anchored(batch, estimates)


def anchored(samples: Aligned, estimates: Estimate) -> Anchored:
    return Anchored(samples, estimates.theta_e, estimates.theta_e_std, estimates.valid)


def joined_pieces(pieces: list[Anchored]) -> Anchored:
    if len(pieces) == 1:
        return pieces[0]
    return Anchored(
        joined([piece.samples for piece in pieces]),
        np.concatenate([piece.angle for piece in pieces]),
        np.concatenate([piece.angle_std for piece in pieces]),
        np.concatenate([piece.valid for piece in pieces]),
    )


def rows_between(piece: Anchored, first: int, last: int) -> Anchored:
    return Anchored(
        between(piece.samples, first, last),
        piece.angle[first:last],
        piece.angle_std[first:last],
        piece.valid[first:last],
    )


def _filled(values: Array) -> Array:
    """Replace rows with a missing component by interpolation."""
    good = np.isfinite(values).all(axis=1)
    if good.all():
        return values
    rows = np.arange(len(values))
    if not good.any():
        return np.zeros(values.shape)
    columns = [np.interp(rows, rows[good], values[good, n]) for n in range(values.shape[1])]
    return np.stack(columns, axis=1)


def _short_gaps_filled(voltage: Array) -> Array:
    """Interpolate short gaps; the volt-seconds of a longer gap and at the ends are unknown.

    No interval ends at the first row: it gets any voltage.
    """
    missing = np.asarray(~np.isfinite(voltage).all(axis=1))
    if not missing.any():
        return voltage
    filled = _filled(voltage)
    for start, end in runs(missing):
        if end - start > SHORT_GAP or (start == 0 and end > 1) or end == len(voltage):
            filled[max(start, 1) : end] = np.nan
    return filled


def record_samples(
    rows: Anchored, anchors: NDArray[np.bool_], inverter: InverterError | None
) -> RecordSamples:
    """Return the samples for the smoother.

    Parameters
    ----------
    rows : Anchored
        Rows with marks.
    anchors : (rows,) ndarray of bool
    inverter : InverterError, optional
        Its loss is subtracted from the voltages.
    """
    samples = rows.samples
    assert samples.marks is not None
    current = _filled(samples.current)
    # Without the current, the resistive drop is unknown.
    unknown = np.asarray(~np.isfinite(samples.current).all(axis=1))
    voltage = np.where(unknown[:, None], np.nan, samples.voltage)
    filled = samples._replace(current=current, voltage=_short_gaps_filled(voltage))
    if inverter is not None:
        filled = less_lost(filled, inverter, current[:1])
    at = np.flatnonzero(anchors)
    turned = np.unwrap(rows.angle[at])
    return RecordSamples(
        filled.voltage,
        current,
        samples.marks,
        np.interp(np.arange(len(current)), at, turned),
        np.where(anchors, rows.angle_std, np.inf),
    )


def without_bridge(rows: Anchored) -> Anchored | None:
    """Return the rows with NaN voltages while the bridge may be off.

    Returns None if a current flows in every row, or in none.
    """
    marks = rows.samples.marks
    assert marks is not None
    off = marks & NO_CURRENT > 0
    if not off.any() or off.all():
        return None
    late = off.copy()
    for _ in range(LATE_INTERVALS):
        late[1:] |= late[:-1]
    voltage = np.where(late[:, None], np.nan, rows.samples.voltage)
    marked = marks | BRIDGE_OFF * off
    return replace(rows, samples=rows.samples._replace(voltage=voltage, marks=marked))


def anchors_of(rows: Anchored) -> NDArray[np.bool_]:
    """Return which rows anchor the smoother."""
    valid = rows.valid & np.isfinite(rows.angle)
    if valid.sum() < FEW_ANCHORS * len(valid):
        valid = valid | (rows.angle_std < POOR_ANCHOR_STD)
    return valid


def usual_speed(rows: Anchored, anchors: NDArray[np.bool_], sample_time: float) -> float:
    """Return the usual electrical speed [rad/s], from the angles of the anchors."""
    both = anchors[1:] & anchors[:-1]
    steps = np.abs(wrap(np.diff(rows.angle)))[both]
    return float(np.percentile(steps, USUAL)) / sample_time if len(steps) else 0.0


def later(rows: Anchored, shift: int) -> Anchored:
    """Return the rows with the voltages of another lag."""
    voltage = shifted(rows.samples.voltage, shift)
    return replace(rows, samples=rows.samples._replace(voltage=voltage))
