"""Where learning starts: it may end in a wrong minimum, or not at all.

The hypotheses about a log try their starts in turns, the most promising first. Once one of them
converges, the others start from its angles and parameters.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.output import in_parallel
from ..logs.time.aligned import less_lost
from ..machines import InductionMachine, RotatingMachine
from ..observers import AdaptiveObserver
from ..observers.adaptive import Learnt
from ..observers.for_log import Prepared, prepare
from ..smoothing.estimate import VALID_STD
from ..smoothing.record import (
    Assumed,
    RecordSamples,
    SmoothedRecord,
    SmoothingModel,
    learn_record,
)
from .anchors import (
    Anchored,
    anchored,
    anchors_of,
    later,
    record_samples,
    usual_speed,
    without_bridge,
)
from .events import LEAST_ANCHORS, SUSPICIOUS_MISFIT, EventSearch
from .fit import doubts_bridge, rank, typical_std
from .hypotheses import Hypothesis, with_inductance

#: Parts of a record that are learnt alone if the whole does not fit, and the largest share of rows
#: that may not fit then.
PARTS, MOST_EVENTS = 4, 0.2
#: No other start is tried if a record converged and the angle is sure on this share of its rows: a
#: log may be slow most of the time. A record that did not settle may fit, with small standard
#: deviations, and be wrong (two of 93 drives of benchmarks/whole_log.py --drives 3 --seed 7).
SURE = 0.2
#: After this number of rounds, the start without the bridge was tried. It comes first or second
#: after the log as it is.
WITHOUT_BRIDGE = 3
#: Another start is better if its standard deviation is smaller by this share: rounding must not
#: decide.
CLEAR = 0.01
#: A minimum is deeper if its objective is smaller by this: a likelihood of 20 to 1. Of 93 drives of
#: benchmarks/whole_log.py --drives 3 --seed 7, one whose rotor rests at the end settled at 7.0 and
#: was wrong by 85°; the right minimum has -2.2.
DEEPER = 3.0
#: If the angle is unsure on more than this share of the rows that are measured, as through a stop,
#: there may be other minima: a second start is tried. A long log is learnt from many segments.
UNSURE = 0.01
#: Cost of an estimate without the direction of injected rows: a lag with which they fit is better.
WITHOUT_DIRECTION = 500.0
#: With this multiple of the standard deviation of the best hypothesis, another has not converged;
#: with less, the record that explains the log better counts. On a drive of
#: benchmarks/whole_log.py --drives 3 --seed 7 σ was 1.93° and 1.88°, and the second was wrong.
LARGER_STD = 1.5
#: A record is learnt again if its own speed asks for blocks that are longer or shorter by this
#: factor.
OTHER_BLOCKS = 2


class Start(NamedTuple):
    """Rows with anchors, assumptions and model from which learning starts."""

    samples: RecordSamples
    assumed: Assumed
    model: SmoothingModel


class Starts:
    """The starts of a log.

    Parameters
    ----------
    run : Prepared
        The observer that anchors the smoother.
    learnt : Learnt, optional
        Parameters that the adaptive observer learnt.
    in_parts : bool
        Whether to search for the event that spoils a record, and to leave it out.
    """

    def __init__(self, run: Prepared, learnt: Learnt | None, in_parts: bool) -> None:
        assert isinstance(run.machine, RotatingMachine)
        self.run, self.learnt, self.in_parts = run, learnt, in_parts
        self.machine: RotatingMachine = run.machine

    def learn(
        self,
        model: SmoothingModel,
        rows: Anchored,
        anchors: NDArray[np.bool_],
        hypotheses: list[Hypothesis],
        known: SmoothedRecord | None = None,
    ) -> list[SmoothedRecord]:
        """Smooth and learn with each hypothesis: only converged records have comparable costs.

        Parameters
        ----------
        known : SmoothedRecord, optional
            Record of another hypothesis that fits: these start from it.
        """
        if known is not None and known.misfit < SUSPICIOUS_MISFIT:
            near = known

            def from_known(hypothesis: Hypothesis) -> SmoothedRecord | None:
                return self.learn_from_record(model, near, rows, hypothesis)

            learnt = [record for record in in_parallel(from_known, iter(hypotheses)) if record]
            if len(learnt) == len(hypotheses):
                return learnt
        moved = [later(rows, hypothesis.shift) for hypothesis in hypotheses]
        starts = [
            self._of(with_inductance(model, hypothesis.inductance), own, anchors)
            for hypothesis, own in zip(hypotheses, moved, strict=True)
        ]

        def learn_next(n: int) -> SmoothedRecord | None:
            start = next(starts[n], None)
            if start is None:
                return None
            return self._learn_from(start, model, moved[n])

        numbers = range(len(hypotheses))
        records = [record for record in in_parallel(learn_next, numbers) if record is not None]
        rounds = 1
        while not self._converged(min(records, key=rank), rounds):
            tried = list(in_parallel(learn_next, numbers))
            if all(record is None for record in tried):
                break
            rounds += 1
            records = [
                new if new is not None and clearly_better(new, old) else old
                for old, new in zip(records, tried, strict=True)
            ]
        return self._learn_from_best(model, rows, hypotheses, records)

    def _converged(self, best: SmoothedRecord, rounds: int) -> bool:
        """Whether no other start needs to be tried after this number of rounds."""
        if not best.misfit < SUSPICIOUS_MISFIT or isinstance(self.machine, InductionMachine):
            return False
        sure = float((best.outputs["theta_e_std"] < VALID_STD).mean())
        unsure = float((best.known & (best.outputs["theta_e_std"] > VALID_STD)).mean())
        verified = rounds > 1 or unsure < UNSURE or not self.in_parts
        tried = rounds >= WITHOUT_BRIDGE or not doubts_bridge(best)
        return best.converged and sure > SURE and tried and verified

    def _learn_from_best(
        self,
        model: SmoothingModel,
        rows: Anchored,
        hypotheses: list[Hypothesis],
        records: list[SmoothedRecord],
    ) -> list[SmoothedRecord]:
        """Start the hypotheses that did not converge from the best one."""
        best = min(records, key=rank)
        if not best.misfit < SUSPICIOUS_MISFIT:
            return records
        usual = LARGER_STD * typical_std(best)

        def again(pair: tuple[Hypothesis, SmoothedRecord]) -> SmoothedRecord:
            hypothesis, record = pair
            fits = record.misfit < SUSPICIOUS_MISFIT and typical_std(record) < usual
            same = record.model.rows_per_block == best.model.rows_per_block
            if record is best or (fits and same and record.converged):
                return record
            other = self.learn_from_record(model, best, rows, hypothesis)
            return record if other is None else cheaper(record, other)

        return list(in_parallel(again, zip(hypotheses, records, strict=True)))

    def _learn_from(self, start: Start, model: SmoothingModel, rows: Anchored) -> SmoothedRecord:
        """Smooth and learn; without the direction of injected rows at a cost."""
        record = learn_record(start.model, start.samples, start.assumed)
        record = self._with_own_speed(record, rows)
        if start.model.numbers["injection"] == model.numbers["injection"]:
            return record
        cost = replace(record.cost, prior=record.cost.prior + WITHOUT_DIRECTION)
        return replace(record, cost=cost)

    def _with_own_speed(self, record: SmoothedRecord, rows: Anchored) -> SmoothedRecord:
        """Learn once more if the blocks do not suit the speed of the record's own estimate.

        An observer that lost the rotor turns too fast. Blocks of a row instead of 16 fit, with
        small standard deviations, and the estimate is wrong.
        """
        anchors = sure_rows(record)
        if not record.misfit < SUSPICIOUS_MISFIT or anchors.sum() < LEAST_ANCHORS:
            return record
        outputs = record.outputs
        own = Anchored(rows.samples, outputs["theta_e"], outputs["theta_e_std"], anchors)
        speed = usual_speed(own, anchors, self.run.log.sample_time)
        model = record.model.with_numbers(speed=speed)
        length, used = model.rows_per_block, record.model.rows_per_block
        if max(length, used) < OTHER_BLOCKS * min(length, used):
            return record
        again = learn_record(model, self.samples(own, anchors), record.assumed)
        return again if again.misfit < SUSPICIOUS_MISFIT else record

    def learn_from_record(
        self,
        model: SmoothingModel,
        known: SmoothedRecord,
        rows: Anchored,
        hypothesis: Hypothesis,
    ) -> SmoothedRecord | None:
        """Learn from the angles and parameters of another hypothesis; None without angles."""
        angle, std = known.outputs["theta_e"], known.outputs["theta_e_std"]
        anchors = sure_rows(known)
        if anchors.sum() < LEAST_ANCHORS:
            return None
        own = with_inductance(
            model.with_numbers(speed=known.model.numbers["speed"]), hypothesis.inductance
        )
        moved = later(rows, hypothesis.shift)
        samples = self.samples(Anchored(moved.samples, angle, std, anchors), anchors)
        start = known.assumed.with_deviation("lag", 0.0).with_deviation("delay", 0.0)
        if hypothesis.inductance != 1:
            start = start.with_deviation("L_d", 0.0).with_deviation("L_q", 0.0)
        return learn_record(own, samples, start)

    def samples(self, rows: Anchored, anchors: NDArray[np.bool_]) -> RecordSamples:
        """Return the samples of rows with anchors."""
        inverter = self.machine.inverter if self.run.log.inverter is None else None
        return record_samples(rows, anchors, inverter)

    def _start(self, model: SmoothingModel) -> Assumed:
        """Return the parameters that the observer learnt."""
        prior, learnt, machine = model.prior(), self.learnt, self.machine
        if learnt is None:
            return prior
        loss = learnt.inverter_voltage - model.numbers["inverter_voltage"]
        deviations = prior.deviations | {
            "resistance": learnt.resistance - machine.R_s,
            "inverter_hard": loss / 2,
            "inverter_soft": loss / 2,
            "offset_alpha": learnt.offset[0],
            "offset_beta": learnt.offset[1],
            "L_d": learnt.inductance_error[0],
            "L_q": learnt.inductance_error[1],
            "psi_f": learnt.psi_f - model.numbers["psi"],
        }
        kept = {name: value if model.stds[name] > 0 else 0.0 for name, value in deviations.items()}
        return Assumed(kept, prior.covariance, prior.filter_scale)

    def _of(
        self, model: SmoothingModel, rows: Anchored, anchors: NDArray[np.bool_]
    ) -> Iterator[Start]:
        """Yield samples, parameters and model to start from, the most promising first."""
        samples = self.samples(rows, anchors)
        start = self._start(model)
        yield Start(samples, start, model)
        if model.measures_direction(samples):  # an oscillation may look like an injection
            yield Start(samples, start, model.without_direction())
        off = without_bridge(rows)
        if off is not None:
            off, length = self.plain_angles(off)
            known = anchors_of(off)
            if known.sum() >= LEAST_ANCHORS:
                yield Start(self.samples(off, known), self._with_length(model, length), model)
        if isinstance(self.machine, InductionMachine):
            yield Start(samples, start, model.with_numbers(rotor_flux_start=0.0))
            return
        yield Start(samples, model.prior(), model)
        if isinstance(self.run.observer, AdaptiveObserver):
            other, length = self.plain_angles(rows)
            anchors = anchors_of(other)
            if anchors.sum() >= LEAST_ANCHORS:
                samples = self.samples(other, anchors)
                model = model.with_numbers(
                    speed=usual_speed(other, anchors, self.run.log.sample_time)
                )
                for guess in (start, model.prior()):
                    yield Start(samples, self._with_length(model, length, guess), model)
        if self.in_parts:
            yield from self._from_parts(model, rows)

    def _from_parts(self, model: SmoothingModel, rows: Anchored) -> Iterator[Start]:
        """Yield the record without the rows of an event that spoils it, if there are few."""
        anchors = anchors_of(rows)
        search = EventSearch(model, self.samples(rows, anchors), anchors, self._start(model))
        count = len(rows.valid)
        edges = np.linspace(0, count, PARTS + 1).astype(int).tolist()
        events = [
            event
            for first, last in zip(edges, edges[1:])  # noqa: B905, RUF007  # the page has no itertools
            for event in search.events(first, last)
        ]
        if search.best is None or sum(b - a for a, b in events) > MOST_EVENTS * count:
            return
        voltage = rows.samples.voltage.copy()
        for first, last in events:
            voltage[first:last] = np.nan
        without = replace(rows, samples=rows.samples._replace(voltage=voltage))
        yield Start(self.samples(without, anchors), search.best.assumed, model)

    def _with_length(
        self, model: SmoothingModel, length: float, start: Assumed | None = None
    ) -> Assumed:
        """Return assumptions with the magnet flux that the plain observer measures, if any."""
        start = model.prior() if start is None else start
        if model.stds["psi_f"] > 0 and self.machine.saliency == 0 and length > 0:
            return start.with_deviation("psi_f", length - model.numbers["psi"])
        return start

    def plain_angles(self, rows: Anchored) -> tuple[Anchored, float]:
        """Return the rows with the angles of the plain observer, and its length of λ - L i [Wb].

        The length is 0 if no row is valid.
        """
        run = prepare(self.run.log, self.machine, ("drift",), None, {}, self.run.scales)
        samples = rows.samples
        if run.log.inverter is not None:
            samples = less_lost(samples, run.log.inverter, samples.current[:1])
        observer: Any = run.observer
        estimates = observer.run(samples.voltage, samples.current)
        known = estimates.valid
        length = float(np.median(estimates.psi_f[known])) if known.any() else 0.0
        return anchored(rows.samples, estimates), length


def sure_rows(record: SmoothedRecord) -> NDArray[np.bool_]:
    """Return the rows whose angle can anchor another record."""
    std = record.outputs["theta_e_std"]
    return np.asarray(record.known & (std < max(VALID_STD, LARGER_STD * typical_std(record))))


def gain(new: SmoothedRecord, old: SmoothedRecord) -> float:
    """Return a positive number if a record explains the log better than another that fits.

    The one that settled is better, then the one in the deeper minimum, then the one of which no
    block was left out.
    """
    if new.settled != old.settled:
        return 1.0 if new.settled else -1.0
    deeper = old.cost.objective - new.cost.objective
    if new.model.rows_per_block == old.model.rows_per_block and abs(deeper) > DEEPER:
        return deeper
    return float(old.left_out) - float(new.left_out)


def clearly_better(new: SmoothedRecord, old: SmoothedRecord) -> bool:
    """Whether a record fits and the other does not, or it is more than a little better.

    Of two records that fit, the one that explains the log better counts, unless its standard
    deviation is much larger: a record that did not settle may have a smaller one and be wrong.
    """
    (new_misfits, new_size), (old_misfits, old_size) = rank(new), rank(old)
    if new_misfits != old_misfits:
        return old_misfits
    if not new_misfits:
        gained = gain(new, old)
        better, other = (new_size, old_size) if gained > 0 else (old_size, new_size)
        if gained != 0 and better < LARGER_STD * other:
            return gained > 0
    return new_size < (1 - CLEAR) * old_size


def cheaper(record: SmoothedRecord, other: SmoothedRecord) -> SmoothedRecord:
    """Return the record of one hypothesis with the smaller cost, if their costs are comparable.

    Of records with different blocks, the one that fits is better.
    """
    same = record.model.rows_per_block == other.model.rows_per_block
    worse = rank(record)[0] or not same or record.cost.objective > other.cost.objective
    return other if worse and np.isfinite(other.cost.objective) else record
