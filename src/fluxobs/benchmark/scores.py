"""Scores of an entrant on a suite, and their summary.

The interval score of a central 95 % interval [l, u] is u - l + 40 times the distance by which the
truth is outside: its mean is least for the true distribution (Gneiting and Raftery 2007,
doi:10.1198/016214506000001437). An entrant without standard deviations gets the constant that suits
it best over the suite.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

from ..comparison.scoring import LOST, settling_time
from ..core.arrays import Array
from ..errors import FluxobsError
from ..machines import RotatingMachine
from .entrants import Entrant, Estimates
from .suite import Entry, Suite

#: True theta_e [rad], and as far as known speed_e [rad/s] and torque [N m], of the rows.
Truth = dict[str, Array]
#: Miss rate of the interval, and its half width in standard deviations of a normal distribution.
ALPHA, HALF_WIDTH = 0.05, 1.959964
#: Quantiles of the errors that are kept of each record.
KEPT = 200
#: Sure and wrong: an error beyond this many standard deviations and this angle [rad].
WRONG_STDS, WRONG = 5.0, np.radians(10.0)


@dataclass(frozen=True, eq=False)
class Score:
    """Score of a record; errors in rad, rad/s and N m. None: not stated, or no such row.

    Attributes
    ----------
    record, machine, course, errors : str
    rms, worst : float
        Over all rows.
    valid : float
        Share of valid rows.
    rms_valid, worst_valid : float, optional
        Over the valid rows.
    within_1, within_2, within_3 : float, optional
        Share of the valid rows within one, two, three standard deviations.
    interval : float, optional
        Mean interval score of all rows [rad].
    first_valid : float, optional
        Time of the first valid row [s].
    settled : float, optional
        Time from which the error stays below 10° for 50 ms [s].
    lost : float
        Share of the rows with an error above 60°.
    sure_and_wrong : bool
        A valid row is off by more than 10° and five standard deviations.
    speed, torque : float, optional
        Rms errors on valid rows.
    seconds : float
        Per sample.
    quantiles : ndarray
        Of the absolute errors of all rows.
    """

    record: str
    machine: str
    course: str
    errors: str
    rms: float
    worst: float
    valid: float
    rms_valid: float | None
    worst_valid: float | None
    within_1: float | None
    within_2: float | None
    within_3: float | None
    interval: float | None
    first_valid: float | None
    settled: float | None
    lost: float
    sure_and_wrong: bool
    speed: float | None
    torque: float | None
    seconds: float
    quantiles: Array


def interval_score(error: Array, std: Array | float) -> Array:
    """Return the interval score of each row [rad]; intervals are at most a turn wide."""
    half = np.minimum(HALF_WIDTH * np.asarray(std), np.pi)
    return np.asarray(2 * half + 2 / ALPHA * np.maximum(error - half, 0.0))


def score_entrant(
    entrant: Entrant, suite: Suite, progress: Callable[[int, int], Any] | None = None
) -> list[Score]:
    """Run an entrant on every record for whose machine it has an observer, and score it.

    Raises
    ------
    FluxobsError
        Estimates have another number of rows than the record.
    """
    scores = []
    for n, entry in enumerate(suite.entries):
        estimates = entrant.run(suite, entry)
        if estimates is not None:
            truth = suite.truth(entry)
            scores.append(score(entrant.name, suite.machine(entry), entry, truth, estimates))
        if progress is not None:
            progress(n + 1, len(suite.entries))
    return scores


def score(
    name: str, machine: RotatingMachine, entry: Entry, truth: Truth, estimates: Estimates
) -> Score:
    """Score the estimates of a record; speed and torque are scored where they are known."""
    rows = len(truth["theta_e"])
    for values in estimates[:-1]:
        if values is not None and np.shape(values) != (rows,):
            raise FluxobsError(f"{entry.name}: {name} returns {np.shape(values)}, not {rows} rows")
    t = np.asarray(entry.sample_time * np.arange(rows), float)
    true_angle = truth["theta_e"]
    theta = np.where(np.isfinite(estimates.theta_e), estimates.theta_e, true_angle + np.pi)
    error = np.asarray(np.abs(machine.position_error(theta, true_angle)), float)
    valid = np.isfinite(estimates.theta_e)
    if estimates.valid is not None:
        valid &= np.asarray(estimates.valid, bool)
    std, known = estimates.theta_e_std, None
    if std is not None:
        known = np.where(np.isfinite(std), std, np.pi)
    of_valid = error[valid]

    def within(multiple: float) -> float | None:
        if known is None or not len(of_valid):
            return None
        return float(np.mean(of_valid <= multiple * known[valid]))

    def rms(values: Array | None, quantity: str) -> float | None:
        if values is None or quantity not in truth:
            return None
        squares = ((values - truth[quantity]) ** 2)[valid]
        known_squares = squares[np.isfinite(squares)]
        return float(np.sqrt(known_squares.mean())) if len(known_squares) else None

    settled = settling_time(t, error)
    wrong = valid & (error > WRONG)
    some = bool(len(of_valid))
    return Score(
        record=entry.name,
        machine=entry.machine,
        course=entry.course,
        errors=entry.errors,
        rms=float(np.sqrt(np.mean(error**2))),
        worst=float(error.max()),
        valid=float(valid.mean()),
        rms_valid=float(np.sqrt(np.mean(of_valid**2))) if some else None,
        worst_valid=float(of_valid.max()) if some else None,
        within_1=within(1.0),
        within_2=within(2.0),
        within_3=within(3.0),
        interval=None if known is None else float(interval_score(error, known).mean()),
        first_valid=float(t[np.argmax(valid)]) if some else None,
        settled=float(settled) if np.isfinite(settled) else None,
        lost=float(np.mean(error > LOST)),
        sure_and_wrong=known is not None and bool((wrong & (error > WRONG_STDS * known)).any()),
        speed=rms(estimates.speed_e, "speed_e"),
        torque=rms(estimates.torque, "torque"),
        seconds=estimates.seconds,
        quantiles=np.quantile(error, (np.arange(KEPT) + 0.5) / KEPT),
    )


@dataclass(frozen=True)
class Summary:
    """Means over records; angles in degrees, `microseconds` per sample."""

    entrant: str
    track: str
    group: str
    records: int
    rms: float
    valid: float
    rms_valid: float | None
    worst_valid: float | None
    within_1: float | None
    within_2: float | None
    within_3: float | None
    interval: float
    first_valid: float | None
    lost_drives: int
    sure_and_wrong: int
    speed: float | None
    torque: float | None
    microseconds: float


#: A drive is lost if the error exceeds 60° on this share of its rows.
LOST_DRIVE = 0.2


def best_constant(scores: Iterable[Score]) -> float:
    """Return the standard deviation that suits an entrant best [rad]."""
    pooled = np.concatenate([score.quantiles for score in scores])
    return float(np.quantile(pooled, 1 - ALPHA)) / HALF_WIDTH


def summarise(entrant: Entrant, scores: list[Score]) -> list[Summary]:
    """Return the summary of all records, then of the kinds of errors and the courses, if many."""
    if not scores:
        return []
    constant = best_constant(scores)
    groups = [("all", scores)]
    for field in ("errors", "course"):
        names = dict.fromkeys(getattr(score, field) for score in scores)
        if len(names) == 1:
            continue
        groups += [(n, [s for s in scores if getattr(s, field) == n]) for n in names]
    return [_summary(entrant, name, members, constant) for name, members in groups]


def _summary(entrant: Entrant, group: str, scores: list[Score], constant: float) -> Summary:
    def median(name: str, factor: float = 1.0) -> float | None:
        values = [getattr(score, name) for score in scores if getattr(score, name) is not None]
        return factor * float(np.median(values)) if values else None

    def weighted(name: str) -> float | None:
        pairs = [(s.valid, getattr(s, name)) for s in scores if getattr(s, name) is not None]
        total = sum(weight for weight, _ in pairs)
        return sum(weight * value for weight, value in pairs) / total if total else None

    worst = [score.worst_valid for score in scores if score.worst_valid is not None]
    intervals = [
        score.interval
        if score.interval is not None
        else float(interval_score(score.quantiles, constant).mean())
        for score in scores
    ]
    degree = float(np.degrees(1.0))
    return Summary(
        entrant=entrant.name,
        track=entrant.track,
        group=group,
        records=len(scores),
        rms=float(np.degrees(np.median([score.rms for score in scores]))),
        valid=float(np.mean([score.valid for score in scores])),
        rms_valid=median("rms_valid", degree),
        worst_valid=degree * max(worst) if worst else None,
        within_1=weighted("within_1"),
        within_2=weighted("within_2"),
        within_3=weighted("within_3"),
        interval=degree * float(np.mean(intervals)),
        first_valid=median("first_valid"),
        lost_drives=sum(score.lost > LOST_DRIVE for score in scores),
        sure_and_wrong=sum(score.sure_and_wrong for score in scores),
        speed=median("speed"),
        torque=median("torque"),
        microseconds=1e6 * float(np.mean([score.seconds for score in scores])),
    )


def table_of(scores: list[Score], entrant: Entrant) -> pl.DataFrame:
    """Return a row per record."""
    names = [name for name in Score.__dataclass_fields__ if name != "quantiles"]
    rows = [{name: getattr(score, name) for name in names} for score in scores]
    return pl.DataFrame(rows, infer_schema_length=None).insert_column(
        0, pl.Series("entrant", [entrant.name] * len(rows))
    )
