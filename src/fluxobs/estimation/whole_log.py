"""Every row of a log from the record before and behind it.

An observer runs forwards; where it knows the angle, it anchors the smoother. A long log is smoothed
in windows that overlap; its parameters are learnt from segments spread over the log.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checking.findings import Check
from ..checking.search import check_log
from ..core.output import in_parallel
from ..errors import FluxobsError
from ..logs.time.aligned import between
from ..machines import RotatingMachine
from ..observers import AdaptiveObserver, LeastSquaresObserver
from ..observers.adaptive import Learnt
from ..observers.for_log import LEAST_NOISE, Prepared
from ..observers.outputs import outputs
from ..smoothing.assumptions import Calibration, with_scale
from ..smoothing.estimate import SmoothedEstimate, smoothed_estimate
from ..smoothing.record import (
    QUANTITIES,
    Assumed,
    SmoothedRecord,
    SmoothingModel,
    smooth_record,
)
from .anchors import (
    Anchored,
    anchors_of,
    forwards,
    joined_pieces,
    later,
    rows_between,
    usual_speed,
    without_bridge,
)
from .budget import Budget
from .columns import EstimateRows, rows_of
from .course import Course, Learning, course_of
from .encoder import delay_cost
from .events import LEAST_ANCHORS, SUSPICIOUS_MISFIT
from .fit import (
    contradiction,
    doubts_bridge,
    inductance_error,
    inverter_loss,
    rank,
)
from .hypotheses import (
    LEAST_WEIGHT,
    Hypothesis,
    mixed,
    other_inductances,
    total_costs,
    weights_of,
    with_inductance,
)
from .lag import UNDECIDED, UNUSUAL_COST, UNUSUAL_LAGS, LagDecision
from .starts import Starts
from .statistics import THIN_ROWS, Statistics

#: Rows of a window of a long log, and rows that it shares with each neighbour: at 20 kHz, 6.6 s
#: and 0.8 s. What lies farther behind a row tells nothing about it.
WINDOW_ROWS, OVERLAP_ROWS = 131_072, 16_384
#: Number of segments of a long log from which parameters are learnt, and their rows.
SEGMENTS, SEGMENT_ROWS = 8, 65_536
#: Cost that excludes a lag.
UNLIKELY = 1e3


@dataclass(frozen=True, eq=False)
class Window:
    """Rows of a window; those from `first` to `last` - 1 belong to it, the others overlap."""

    rows: Anchored
    first: int
    last: int


@dataclass(frozen=True, eq=False)
class SmoothedWindow:
    """A window with its estimates.

    Attributes
    ----------
    window : Window
    record : SmoothedRecord, optional
        None if nothing anchors the rows.
    square : float, optional
        Mean square of the difference of the positions to another probable lag [rad^2].
    contradiction : str
        Item that contradicts its prior, or an empty string.
    """

    window: Window
    record: SmoothedRecord | None = None
    square: float | None = None
    contradiction: str = ""


class WholeLog:
    """The smoother of a log, after the observer's parameters were learnt.

    Parameters
    ----------
    run : Prepared
        The observer that anchors the smoother.
    state : Any
        State from which the observer starts.
    learnt : Learnt, optional
        Parameters that the adaptive observer learnt.
    priors : mapping
        See :func:`~fluxobs.smoothing.assumptions.prior_stds`.
    count : callable
        Called with the number of rows that a step has processed.
    shifts : tuple of int
        Possible errors of the log's lag [samples].
    """

    def __init__(
        self,
        run: Prepared,
        state: Any,
        learnt: Learnt | None,
        priors: Mapping[str, float],
        count: Callable[[int], Any],
        shifts: tuple[int, ...] = (0,),
    ) -> None:
        assert isinstance(run.machine, RotatingMachine)
        self.run, self.state, self.learnt = run, state, learnt
        self.machine: RotatingMachine = run.machine
        self.priors, self.count = priors, count
        self.calibration = Calibration.of(priors)
        self.long = len(run.log) > WINDOW_ROWS + 2 * OVERLAP_ROWS
        self.starts = Starts(run, learnt, in_parts=not self.long)
        self.budget = Budget.for_machine(self.machine, priors)
        self.model: SmoothingModel | None = None
        self.hypotheses = [
            Hypothesis(
                shift, prior=UNUSUAL_COST if len(shifts) > 1 and shift in UNUSUAL_LAGS else 0
            )
            for shift in shifts
        ]
        self.weights: dict[int, float] = {}
        self.checked: Check | None = None
        self._learnt = False
        self._difference, self._compared = 0.0, 0

    @property
    def plain(self) -> LeastSquaresObserver:
        """The plain observer, alone or inside the adaptive one."""
        observer: Any = self.run.observer
        return observer.plain if isinstance(observer, AdaptiveObserver) else observer

    @property
    def best(self) -> Hypothesis:
        """The most probable lag."""
        return self.hypotheses[0]

    @property
    def course(self) -> Course:
        """The course of the parameters with the most probable lag."""
        return self.best.course

    def lag(self) -> LagDecision | None:
        """Return the lag that was learnt; None if it was given."""
        if len(self.weights) < 2:
            return None
        lag = self.run.log.layout.lag
        weights = {lag + shift: weight for shift, weight in self.weights.items()}
        difference = self._difference / self._compared if self._compared else float("nan")
        return LagDecision(lag + self.best.shift, weights, float(np.sqrt(difference)))

    def fractional_lag(self) -> tuple[float, float] | None:
        """Return the lag of the voltages behind the currents and its std [samples]; None: unknown.

        A delay of the currents is part of it: only the difference changes the relation.
        """
        model = self.model
        if model is None or not len(self.course.times):
            return None
        values, variances, weights = [], [], []
        active = [n for n, name in enumerate(model.active) if name in ("lag", "delay")]
        for hypothesis in self.hypotheses:
            times = hypothesis.course.times
            if not len(times):
                continue
            assumed = hypothesis.course.at(float(np.mean(times)), model)
            late = assumed.deviations["lag"] + assumed.deviations["delay"]
            values.append(self.run.log.layout.lag + hypothesis.shift - late)
            variances.append(float(assumed.covariance[np.ix_(active, active)].sum()))
            weights.append(hypothesis.weight)
        share = np.array(weights) / sum(weights)
        mean = float(share @ np.array(values))
        spread = share @ (np.array(variances) + (np.array(values) - mean) ** 2)
        return mean, float(np.sqrt(max(float(spread), 0.0)))

    def _weigh(self) -> None:
        """Weigh the lags by their costs; the best comes first, improbable ones go."""
        weights = weights_of(self._costs())
        for hypothesis, weight in zip(self.hypotheses, weights, strict=True):
            hypothesis.weight = float(weight)
        self.hypotheses.sort(key=lambda hypothesis: -hypothesis.weight)
        self.weights = dict.fromkeys([hypothesis.shift for hypothesis in self.hypotheses], 0.0)
        for hypothesis in self.hypotheses:
            self.weights[hypothesis.shift] += hypothesis.weight
        self._examine()
        self.budget.wrong_inductance = sum(h.weight for h in self.hypotheses if h.inductance != 1)
        self.hypotheses = [h for h in self.hypotheses if h.weight > LEAST_WEIGHT]
        self._learnt = True

    def _costs(self) -> list[float]:
        """Return the costs of the hypotheses, summed over the segments."""
        sums = [hypothesis.prior for hypothesis in self.hypotheses]
        for costs in zip(*(hypothesis.costs for hypothesis in self.hypotheses), strict=True):
            sums = [a + b for a, b in zip(sums, total_costs(costs), strict=True)]
        return sums

    @property
    def _cheapest(self) -> Hypothesis:
        costs = self._costs()
        return self.hypotheses[costs.index(min(costs))]

    def _examine(self) -> None:
        """Check the log: with exchanged or turned vectors, an estimate may fit and be wrong."""
        if self.model is None:
            return
        try:
            log = self.run.log
            decided = self.weights[self.best.shift] > 1 - UNDECIDED
            if decided and self._fits(self.best, self.model):
                log = log.lagged(self.best.shift)
            self.checked = check_log(log, self.machine, scales=self.run.scales)
        except FluxobsError:  # too many gaps
            self.checked = None

    def _fits(self, hypothesis: Hypothesis, model: SmoothingModel) -> bool:
        """Whether the log fits with a hypothesis: else what was learnt means nothing."""
        course = hypothesis.course
        if not len(course.times) or not course.misfit < SUSPICIOUS_MISFIT:
            return False
        return not contradiction(model, course.at(float(np.mean(course.times)), model))

    def rows(self) -> Iterator[EstimateRows]:
        """Yield the estimates of all rows in order, a window at a time."""
        if self.long:
            self._learn_segments()
        windows = self._windows()
        if self._learnt and self.model is not None:
            smoothed = in_parallel(self._smoothed, windows)
        else:  # the windows learn, one after the other
            smoothed = (self._smoothed(window) for window in windows)
        for window in smoothed:
            yield self._finished(window)

    def _windows(self) -> Iterator[Window]:
        """Run the observer forwards and yield windows that overlap."""
        buffer: list[Anchored] = []
        held, first = 0, 0  # rows in the buffer; rows of it that belong to the window before
        for state, piece in forwards(self.run, self.state):
            self.state = state
            buffer.append(piece)
            held += len(piece.valid)
            while self._learnt and held >= first + WINDOW_ROWS + OVERLAP_ROWS:
                rows = joined_pieces(buffer)
                last = first + WINDOW_ROWS
                yield Window(rows_between(rows, 0, last + OVERLAP_ROWS), first, last)
                start = max(0, last - OVERLAP_ROWS)
                buffer = [rows_between(rows, start, held)]
                held, first = held - start, last - start
        yield Window(joined_pieces(buffer), first, held)

    def _segments(self) -> Iterator[Anchored]:
        """Yield segments that are spread over a long log, with the angles of the observer."""
        log, observer = self.run.log, self.run.observer
        starts = np.linspace(log.first, log.last - SEGMENT_ROWS, SEGMENTS).astype(int)
        if not log.table.random_access:
            starts = log.first + SEGMENT_ROWS * np.arange(SEGMENTS)
        for start in starts:
            state: Any = self.state
            if isinstance(observer, AdaptiveObserver):
                state = observer.restart(state, frozen=True)
            pieces = [
                piece
                for _, piece in forwards(self.run, state, int(start), int(start) + SEGMENT_ROWS)
            ]
            yield joined_pieces(pieces)

    def _learn_segments(self) -> None:
        """Learn the course of the parameters from segments of a long log."""
        self._learn_from_segments(self.hypotheses, self.count)
        others = self._other_inductances()
        if others:
            self._learn_from_segments(others, lambda _: None)
            self.hypotheses += others
        self._weigh()
        self.budget.misfit = self.course.misfit

    def _learn_from_segments(
        self, hypotheses: list[Hypothesis], count: Callable[[int], Any]
    ) -> None:
        """Learn the course of each hypothesis, and add its cost."""
        learnings: list[list[Learning]] = [[] for _ in hypotheses]
        speeds: list[float] = []

        def learn(segment: Anchored) -> tuple[Anchored, list[SmoothedRecord]]:
            anchors = anchors_of(segment)
            model = self._model_for(segment, anchors)
            return segment, self.starts.learn(model, segment, anchors, hypotheses)

        for segment, records in in_parallel(learn, self._anchored_segments(count)):
            self._add_costs(hypotheses, records, segment)
            time = float(segment.samples.t[len(segment.valid) // 2])
            for n, record in enumerate(records):
                learnings[n].append(Learning(time, record.assumed, record.misfit))
            best = min(records, key=rank)
            if best.misfit < SUSPICIOUS_MISFIT:
                speeds.append(best.model.numbers["speed"])
        for n, hypothesis in enumerate(hypotheses):
            if self.model is not None and learnings[n]:
                hypothesis.course = course_of(self.model, learnings[n])
        if self.model is not None and speeds:
            self.model = self.model.with_numbers(speed=max(speeds))

    def _other_inductances(self) -> list[Hypothesis]:
        """Return hypotheses of a wrong inductance if what was learnt is suspicious."""
        best = self._cheapest
        if self.model is None or not len(best.course.times):
            return []
        assumed = best.course.at(float(np.mean(best.course.times)), self.model)
        if contradiction(self.model, assumed):
            return []  # another inductance would hide it, as it hides a sagging link
        return [
            Hypothesis(best.shift, factor, prior=cost + best.prior)
            for factor, cost in other_inductances(self.model, assumed)
        ]

    def _anchored_segments(self, count: Callable[[int], Any]) -> Iterator[Anchored]:
        """Yield the segments whose angles are known; the first decides the model."""
        for segment in self._segments():
            count(len(segment.valid))
            anchors = anchors_of(segment)
            if anchors.sum() >= LEAST_ANCHORS:
                self._model_for(segment, anchors)
                yield segment

    def _model_for(self, rows: Anchored, anchors: NDArray[np.bool_]) -> SmoothingModel:
        """Return the model of the log; the first record decides the usual speed."""
        if self.model is None:
            scales, rated = self.run.scales, self.machine.rated_current or self.run.scales.current
            noise = max(scales.current_noise, LEAST_NOISE * rated)
            h = self.run.log.sample_time
            self.model = SmoothingModel.of(
                self.machine,
                scales,
                h,
                float(self.plain.flux_base),
                noise,
                usual_speed(rows, anchors, h),
                self.priors,
            )
        return self.model

    def _add_costs(
        self, hypotheses: list[Hypothesis], records: list[SmoothedRecord], rows: Anchored
    ) -> None:
        """Add what a record of each hypothesis costs."""
        truth, lag_is_known = rows.samples.truth, len(self.hypotheses) < 2
        comparable = len({record.model.rows_per_block for record in records}) == 1
        best = min(records, key=rank)
        for hypothesis, record in zip(hypotheses, records, strict=True):
            cost = record.cost
            if not lag_is_known:
                late = delay_cost(record, truth, self.run.log, self.machine)
                cost = replace(cost, prior=cost.prior + late)
            if not comparable and record is not best:  # another start with other blocks fits better
                cost = replace(cost, innovations=best.cost.innovations + UNLIKELY)
            hypothesis.costs.append(cost)

    def _smoothed(self, window: Window) -> SmoothedWindow:
        """Smooth a window."""
        rows = window.rows
        anchors = anchors_of(rows)
        if anchors.sum() < LEAST_ANCHORS:
            return SmoothedWindow(window)
        model = self._model_for(rows, anchors)
        if len(rows.valid) < 2 * model.rows_per_block:
            return SmoothedWindow(window)
        if not self._learnt:
            records = self._learn_window(model, rows, anchors)
        else:
            middle = float(rows.samples.t[(window.first + window.last) // 2])
            records = [
                self._with_course(
                    with_inductance(model, hypothesis.inductance),
                    later(rows, hypothesis.shift),
                    anchors,
                    hypothesis.course.at(middle, model),
                )
                for hypothesis in self.hypotheses
            ]
        weights = [hypothesis.weight for hypothesis in self.hypotheses]
        differs = [
            "L_d" if hypothesis.inductance != self.best.inductance else "lag"
            for hypothesis in self.hypotheses[1:]
        ]
        record, square = mixed(records, weights, differs)
        return SmoothedWindow(window, record, square, contradiction(model, record.assumed))

    def _with_course(
        self,
        model: SmoothingModel,
        rows: Anchored,
        anchors: NDArray[np.bool_],
        assumed: Assumed,
    ) -> SmoothedRecord:
        """Smooth with learnt parameters."""
        samples = self.starts.samples(rows, anchors)
        record = smooth_record(model, samples, assumed, learning=False)
        if record.misfit > SUSPICIOUS_MISFIT and model.measures_direction(samples):
            other = smooth_record(model.without_direction(), samples, assumed, learning=False)
            record = min(record, other, key=rank)
        if doubts_bridge(record):
            off = without_bridge(rows)
            assert off is not None
            off, _ = self.starts.plain_angles(off)
            known = anchors_of(off)
            if known.sum() >= LEAST_ANCHORS:
                other = smooth_record(
                    model, self.starts.samples(off, known), assumed, learning=False
                )
                record = min(record, other, key=rank)
        return record

    def _finished(self, smoothed: SmoothedWindow) -> EstimateRows:
        """Return the estimates of the rows of a window, and add them to the budget."""
        window, record = smoothed.window, smoothed.record
        rows, first, last = window.rows, window.first, window.last
        self.budget.contradiction = self.budget.contradiction or smoothed.contradiction
        rearranged = self.checked is not None and self.checked.rearranged
        if record is None or smoothed.contradiction or rearranged or not record.known.any():
            return self._unknown(rows, first, last)
        if smoothed.square is not None:
            self._difference += smoothed.square * (last - first)
            self._compared += last - first
        voltage, std = inverter_loss(record.model, record.assumed)
        estimates = smoothed_estimate(record, voltage, std, self.calibration)
        self._add_budget(rows, record, estimates, first, last)
        doubtful = record.outputs["doubtful"][first:last] > 0
        self.budget.add_stretches(rows.samples.t[first:last], doubtful)
        marked = replace(rows, samples=rows.samples._replace(marks=record.marks))
        columns = self._columns(marked, estimates, first, last)
        columns.more["unexplained"] = doubtful.astype(float)
        return columns

    def _learn_window(
        self, model: SmoothingModel, rows: Anchored, anchors: NDArray[np.bool_]
    ) -> list[SmoothedRecord]:
        """Learn from the only window of a short log; return the record of each lag."""
        time = float(rows.samples.t[len(rows.valid) // 2])
        records: list[tuple[Hypothesis, SmoothedRecord]] = []

        def learn(hypotheses: list[Hypothesis], known: SmoothedRecord | None = None) -> None:
            learnt = self.starts.learn(model, rows, anchors, hypotheses, known)
            self._add_costs(hypotheses, learnt, rows)
            for hypothesis, record in zip(hypotheses, learnt, strict=True):
                learning = Learning(time, record.assumed, record.misfit)
                hypothesis.course = course_of(model, [learning])
                records.append((hypothesis, record))

        learn(self.hypotheses)
        others = self._other_inductances()
        if others:
            cheapest = self._cheapest
            learn(others, next(record for own, record in records if own is cheapest))
            self.hypotheses += others
        self._weigh()
        kept = [
            record for hypothesis in self.hypotheses for own, record in records if own is hypothesis
        ]
        self.budget.misfit = kept[0].misfit
        return kept

    def parameters(self, statistics: Statistics) -> Learnt | None:
        """Return the learnt parameters, with resistance and magnet flux averaged over the run."""
        model = self.model
        if model is None or not len(self.course.times):
            return self.learnt
        assumed = self.course.at(float(np.mean(self.course.times)), model)
        stds = dict(zip(model.active, np.sqrt(np.diag(assumed.covariance)), strict=True))
        deviations = assumed.deviations
        loss, loss_std = inverter_loss(model, assumed)
        valid = statistics.valid > 0

        def pair(*names: str) -> tuple[tuple[float, float], tuple[float, float]]:
            a, b = names
            values = (deviations[a], deviations[b])
            return values, (float(stds.get(a, 0.0)), float(stds.get(b, 0.0)))

        offset, offset_std = pair("offset_alpha", "offset_beta")
        asymmetry, asymmetry_std = pair("voltage_gain_re", "voltage_gain_im")
        (L_d, L_d_std), (L_q, L_q_std) = (self._inductance_error(model, axis) for axis in "dq")
        psi_f = model.numbers["psi"] + deviations["psi_f"]
        resistance = model.numbers["resistance"] + deviations["resistance"]
        psi_std, resistance_std = (
            float(with_scale(stds.get(name, 0.0), value, scale, model.stds[name]))
            for name, value, scale in (
                ("psi_f", psi_f, self.calibration.voltage),
                ("resistance", resistance, self.calibration.ratio),
            )
        )
        magnets = self.machine.magnets
        return Learnt(
            psi_f=statistics.mean("psi_f") if valid and magnets else psi_f,
            psi_f_std=statistics.mean("psi_f_std") if valid and magnets else psi_std,
            resistance=statistics.mean("resistance") if valid else resistance,
            resistance_std=statistics.mean("resistance_std") if valid else resistance_std,
            inverter_voltage=max(loss, 0.0),
            inverter_std=loss_std,
            offset=offset,
            offset_std=offset_std,
            asymmetry=asymmetry,
            asymmetry_std=asymmetry_std,
            inductance_error=(L_d, L_q),
            inductance_std=(L_d_std, L_q_std),
        )

    def _inductance_error(self, model: SmoothingModel, axis: str) -> tuple[float, float]:
        """Return the error of an inductance, averaged over the hypotheses, and its std [1]."""
        if not model.stds[f"L_{axis}"] > 0:
            return 0.0, 0.0
        ratios, variances, weights = [], [], []
        for hypothesis in self.hypotheses:
            times = hypothesis.course.times
            assumed = hypothesis.course.at(float(np.mean(times)) if len(times) else 0.0, model)
            error, std = inductance_error(model, assumed, axis, self.calibration)
            ratios.append((1 + error) * hypothesis.inductance)
            variances.append((std * hypothesis.inductance) ** 2)
            weights.append(hypothesis.weight)
        share = np.array(weights) / sum(weights)
        mean = float(share @ np.array(ratios))
        spread = share @ (np.array(variances) + (np.array(ratios) - mean) ** 2)
        return mean - 1, float(np.sqrt(spread))

    def _add_budget(
        self,
        rows: Anchored,
        record: SmoothedRecord,
        estimates: SmoothedEstimate,
        first: int,
        last: int,
    ) -> None:
        m = record.model.rows_per_block  # another start may have another usual speed
        begin, end = -(-first // m), min(last // m, len(record.shares))
        if end <= begin:
            return
        middles = rows.samples.t[begin * m + m // 2 : end * m : m][: end - begin]
        valid = estimates.valid[begin * m : end * m].reshape(-1, m).sum(axis=1)
        stride = max(1, len(self.run.log) // (m * THIN_ROWS))
        scales = np.zeros((end - begin, len(QUANTITIES)))
        flux, torque = estimates.flux[begin * m : end * m : m], estimates.torque
        scales[:, QUANTITIES.index("flux")] = (
            self.calibration.voltage**2 * (flux**2).sum(axis=1) / 2
        )
        scales[:, QUANTITIES.index("torque")] = (
            self.calibration.ratio * torque[begin * m : end * m : m]
        ) ** 2
        self.budget.add(middles, record.shares[begin:end], scales, valid.astype(float), stride)

    def _columns(
        self, rows: Anchored, estimates: SmoothedEstimate, first: int, last: int
    ) -> EstimateRows:
        names = [output.name for output in outputs(SmoothedEstimate)]
        part = SmoothedEstimate(**{name: getattr(estimates, name)[first:last] for name in names})
        samples = between(rows.samples, first, last)
        return rows_of(self.run.log, self.machine, self.run.observer, samples, part)

    def _unknown(self, rows: Anchored, first: int, last: int) -> EstimateRows:
        """Return rows of which nothing is known: the rotor never turned, or no row fits."""
        n = len(rows.valid)
        zeros, unknown = np.zeros(n), np.full(n, np.nan)
        plain = self.plain
        estimates = SmoothedEstimate(
            flux=np.zeros((n, 2)),
            flux_std=np.full((n, 2), np.nan),
            psi_f=np.full(n, float(plain.flux_base)),
            psi_f_std=unknown,
            theta_e=np.where(np.isfinite(rows.angle), rows.angle, 0.0),
            theta_e_std=np.full(n, np.pi / np.sqrt(3)),
            speed_e=zeros,
            speed_e_std=unknown,
            drift=np.zeros((n, 2)),
            drift_std=unknown,
            resistance=np.full(n, self.machine.R_s),
            resistance_std=unknown,
            inverter_voltage=np.full(n, self.machine.inverter_voltage or 0.0),
            inverter_voltage_std=unknown,
            torque=zeros,
            torque_std=unknown,
            innovation=zeros,
            valid=np.zeros(n, bool),
        )
        return self._columns(rows, estimates, first, last)
