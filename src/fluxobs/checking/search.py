"""Search for the mistakes that explain a log best."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..logs.log import Log
from ..logs.record import signed
from ..logs.scales import Scales, measure_scales
from ..machines import RotatingMachine
from ..machines.model.frames import PHASE_CURRENTS
from ..machines.model.inverter import SMOOTHING
from .columns import check_columns
from .findings import UNSEEN, Check, Finding
from .mistakes import (
    AS_GIVEN,
    DELTA,
    FACTOR,
    FILE,
    FRAME,
    KINDS,
    LAG,
    LINE,
    NEUTRAL,
    ODDS,
    PHASES,
    RIGHT,
    SAME,
    SCALES,
    SIGN,
    Mistake,
    combine,
    inverted_sensors,
)
from .relation import (
    INVERTER,
    MODEL,
    PSI,
    R,
    RelationFit,
    RelationResidual,
    integrate_segments,
    paired_rows,
)
from .segments import Segments, cut_segments
from .truth import check_truth

#: Explanations whose costs differ by less than this, two standard deviations, are ambiguous.
AMBIGUOUS = 4.0
#: With a residual above this share of the flux, no explanation fits.
BAD = 0.2
#: Kinds of findings that end the check before the search.
FATAL = ("columns", "angle")
#: A parameter is identifiable if the standard deviation of its logarithm is smaller than this.
IDENTIFIABLE = 0.1
#: If the magnet flux is n_p times too large, to within this share, theta_e is a mechanical angle.
NEAR_N_P = 0.05
#: Report an inverter voltage if it exceeds this many standard deviations.
CLEAR = 3.0
#: Other vectors explain a log only if they reduce the residual to this share. In logs with
#: exchanged phases or the currents of a delta it is 0.001 to 0.09, with a sagging link 0.3.
REARRANGED = 0.15
#: Largest number of simultaneous mistakes.
MOST_MISTAKES = 3
#: Starting values for the logarithm of an unknown factor: powers of two up to about ten thousand.
FACTORS = np.linspace(-9.1, 9.1, 27)
#: A voltage below STANDSTILL times the resistive drop means standstill; a voltage below IMPLAUSIBLE
#: times the drop means a mistake.
STANDSTILL, IMPLAUSIBLE = 1.5, 0.3


@dataclass(frozen=True)
class Candidate:
    """The correction of one more mistake, and the resulting fit."""

    mistake: Mistake
    whole: Mistake  # this mistake combined with the mistakes found before
    fit: RelationFit
    odds: float
    size: float  # mean magnitude of the voltage [V]

    def cost(self, level: float) -> float:
        """Return the cost; `level` divides the misfit."""
        return self.fit.misfit / level + self.fit.distance + self.odds


@dataclass(frozen=True)
class SearchResult:
    """Result of a search.

    Attributes
    ----------
    given, best : Candidate
        The fit without corrections, and the fit with the best corrections.
    mistakes : list of Mistake
        Mistakes that were found.
    alternatives : dict
        Kind of mistake → texts of other mistakes that explain the log equally well.
    candidates : list of Candidate
        The best candidate, then the best candidate with each further mistake.
    level : float
        Divisor of the misfits in a cost.
    """

    given: Candidate
    best: Candidate
    mistakes: list[Mistake]
    alternatives: dict[str, tuple[str, ...]]
    candidates: list[Candidate]
    level: float


def possible_mistakes(machine: RotatingMachine, log: Log) -> list[Mistake]:
    """Return the mistakes that are possible for this machine and log, simple mistakes first."""
    frame = log.frame
    measured = "".join(name[-1] for name in PHASE_CURRENTS if name in log.names)
    sign_and_phases = [
        replace(combine(sign, phases), kind="phases", words=f"{phases.words}, and {sign.words}")
        for sign in SIGN
        for phases in PHASES
    ]
    scales = [mistake for mistake in [*SCALES, *FACTOR] if machine.magnets or not mistake.only_flux]
    if not machine.magnets:  # a common scale of voltages and currents changes nothing
        scales.remove(FACTOR[-1])
    file_values = [mistake for mistake in FILE if machine.magnets or not mistake.only_flux]
    frames = FRAME if frame == "alphabeta" else []
    line_voltages = {"abc": LINE, "line": NEUTRAL}.get(frame, [])
    windings = DELTA if frame in ("abc", "line", "duty") else []
    one_sensor = inverted_sensors(measured) if len(measured) == 2 else []
    return [
        *file_values,
        *SIGN,
        *one_sensor,
        *PHASES,
        *LAG,
        *frames,
        *line_voltages,
        *windings,
        *scales,
        *sign_and_phases,
    ]


class Search:
    """Search on one set of segments; it stores the relation of each arrangement of vectors."""

    def __init__(self, machine: RotatingMachine, data: Segments, scales: Scales):
        self.machine, self.data, self.scales = machine, data, scales
        rated = machine.rated_current or scales.current
        self.smoothing = machine.inverter_current or SMOOTHING * rated
        self.relations: dict[Any, RelationResidual] = {}

    def refit(self, candidate: Candidate, others: list[Candidate]) -> Candidate:
        """Fit again, starting at the best fit of other candidates with the same vectors."""
        same = [other for other in others if other.whole.arrangement == candidate.whole.arrangement]
        best = min(same, key=lambda other: other.fit.misfit, default=candidate)
        if not best.fit.misfit < candidate.fit.misfit:
            return candidate
        relation = self.relations[candidate.whole.arrangement]
        prior = candidate.whole.prior(self._inverter_share(relation))
        fit = relation.fit(prior, best.fit.values)
        worse = fit.misfit + fit.distance >= candidate.fit.misfit + candidate.fit.distance
        return candidate if worse else replace(candidate, fit=fit)

    def _inverter_share(self, relation: RelationResidual) -> float:
        """Return the machine file's inverter voltage divided by the log's voltage."""
        return (self.machine.inverter_voltage or 0.0) / (relation.data.size + 1e-300)

    def attempt(self, before: Mistake, mistake: Mistake, odds: float) -> Candidate:
        """Correct a mistake in addition to `before`, and fit."""
        whole = combine(before, mistake)
        key = whole.arrangement
        if key not in self.relations:
            integrated = integrate_segments(
                self.data,
                whole.voltage(self.data.voltage[whole.lag]),
                whole.current(self.data.current),
                self.smoothing,
            )
            self.relations[key] = RelationResidual(
                self.machine, integrated, self.scales.current_noise
            )
        relation = self.relations[key]
        prior = whole.prior(self._inverter_share(relation))
        start, direction = prior.mean, np.array([*whole.loose, 0.0])
        if direction[:2].any():
            start = min((prior.mean + s * direction for s in FACTORS), key=relation.misfit)
        fit = relation.fit(prior, start)
        extra_odds = ODDS if mistake.kind else 0.0
        return Candidate(mistake, whole, fit, odds + extra_odds, relation.data.size)

    def run(
        self, possible: list[Mistake], progress: Callable[[int, int], Any] | None
    ) -> SearchResult:
        """Correct the mistake that explains the log best; repeat until none improves the cost."""
        best = given = self.attempt(AS_GIVEN, AS_GIVEN, 0.0)
        found: list[Mistake] = []
        equivalent: dict[str, tuple[str, ...]] = {}
        while True:
            candidates = [best]
            for n, mistake in enumerate(possible):
                if mistake.kind not in {earlier.kind for earlier in found}:
                    candidates.append(self.attempt(best.whole, mistake, best.odds))
                if progress is not None:
                    progress(len(found) * len(possible) + n + 1, (len(found) + 1) * len(possible))
            candidates = [self.refit(candidate, candidates) for candidate in candidates]
            best = candidates[0]
            given = best if not found else given
            share = min(candidate.fit.share for candidate in candidates)
            level = max(1.0, (share / MODEL) ** 2)
            lowest = min(candidate.cost(level) for candidate in candidates)
            # Where nothing turns, no cost is finite, and nothing improves it.
            if not best.cost(level) > lowest or len(found) == MOST_MISTAKES:
                return SearchResult(given, best, found, equivalent, candidates, level)
            alike = [
                candidate
                for candidate in candidates[1:]
                if candidate.cost(level) < lowest + AMBIGUOUS
            ]
            best = alike[0]  # the simplest
            found.append(best.mistake)
            equivalent[best.mistake.kind] = tuple(
                dict.fromkeys(candidate.mistake.words for candidate in alike[1:])
            )


def check_log(
    log: Log,
    machine: RotatingMachine,
    progress: Callable[[int, int], Any] | None = None,
    scales: Scales | None = None,
) -> Check:
    """Check an open log; measure its scales if they are not given."""
    log = log.less_inverter(None)
    column_findings = check_columns(log)
    if any(finding.kind in FATAL for finding in column_findings):
        note = "Correct this first; no other mistakes were tested."
        return Check(tuple(column_findings), None, None, (note,))
    measured = measure_scales(log) if scales is None else scales
    possible = possible_mistakes(machine, log)
    search = Search(machine, cut_segments(log, machine, scales=measured), measured)
    result = search.run(possible, progress)
    if (vectors := (result.best.whole.current, result.best.whole.voltage)) != (SAME, SAME):
        # The segments were chosen by an EMF from wrong vectors: choose the segments again.
        search = Search(machine, cut_segments(log, machine, *vectors, scales=measured), measured)
        result = search.run(possible, progress)
    given, best = result.given, result.best
    if not best.fit.share < BAD:
        return _report_no_fit(log, machine, search, column_findings, given)
    findings = [
        _make_finding(kind, result, log.layout.lag, machine.flux_name)
        for kind in KINDS
        if any(mistake.kind == kind for mistake in possible)
    ]
    fits = _describe_fit(best, machine)
    findings = [
        _complete_scale(finding, best, machine, fits, log.current_frame) for finding in findings
    ]
    true = log.true
    notes = (UNSEEN,) if true is None or true.channel.startswith("speed") else ()
    data = search.data
    if true is not None and not true.guessed and true.angular and data.truth is not None:
        rows = paired_rows(data.current.shape[1], data.apart)
        lagged_fits = {
            candidate.mistake.lag: candidate.fit
            for candidate in result.candidates
            if candidate.mistake.kind == "lag"
        }
        fits_by_lag = {0: best.fit} | (lagged_fits if not result.mistakes else {})
        findings += check_truth(true.channel, machine, data, fits_by_lag, rows, log.layout.lag)
    ln_R, ln_L, ln_psi = best.fit.values[: PSI + 1].tolist()
    factors = (float(np.exp(ln_R)), float(np.exp(ln_L)), float(np.exp(ln_psi)))
    vectors = (best.whole.current, best.whole.voltage)
    rearranged = vectors != (SAME, SAME) and best.fit.share < REARRANGED * given.fit.share
    residuals = given.fit.share, best.fit.share
    return Check((*column_findings, *findings), *residuals, notes, fits, factors, rearranged)


def _report_no_fit(
    log: Log,
    machine: RotatingMachine,
    search: Search,
    column_findings: list[Finding],
    given: Candidate,
) -> Check:
    """Return the check of a log that no explanation fits, with a likely cause."""
    data = search.data
    drops = float(
        np.median(np.abs(data.voltage[0])) / np.median(machine.R_s * np.abs(data.current))
    )
    message = "no arrangement of signs, phases, lag and scales fits this machine" + (
        f": the drop at R_s would be {1 / drops:.3g} times the voltage of this log. Are "
        f"currents in mA or counts, or is R_s in mΩ?"
        if drops < IMPLAUSIBLE
        else ": the voltage is hardly more than the resistive drop, as at standstill. Does the "
        "machine turn in this log?"
        if drops < STANDSTILL
        else ". Does the machine turn in this log, and are its kind, R_s and inductances right?"
    )
    other_kind = _find_other_kind(machine, search)
    if other_kind is not None:
        message = other_kind
    finding = Finding("machine", message, False)
    return Check((*column_findings, finding), given.fit.share, given.fit.share)


def _find_other_kind(machine: RotatingMachine, search: Search) -> str | None:
    """Return a message if a machine with a magnet fits, but this machine has no magnet."""
    from ..machines import SurfacePMSM

    if machine.magnets:
        return None
    L_d, L_q = machine.L_dq
    for inductance in (L_q, L_d, L_q / 10):
        magnet = SurfacePMSM(R_s=machine.R_s, L_s=inductance, n_p=machine.n_p)
        any_inductance = Mistake("machine", "", loose=(0, 1, 0))
        with_magnet = Search(magnet, search.data, search.scales)
        fit = with_magnet.attempt(AS_GIVEN, any_inductance, 0.0).fit
        if fit.share < BAD / 4:
            return (
                f"a machine of kind {machine.kind} does not fit, but a machine with a magnet does "
                f"(surface-pmsm, psi_f about {np.sqrt(np.mean(np.abs(fit.position) ** 2)):.3g} Wb)"
            )
    return None


def _make_finding(kind: str, result: SearchResult, lag: float, flux_name: str) -> Finding:
    """Return the finding on one kind of mistake."""
    best, level = result.best, result.level

    def describe(mistake: Mistake) -> str:
        if kind == "lag":
            return signed(lag + mistake.lag)
        return mistake.words.replace("psi_f", flux_name)

    mistake_found = next((mistake for mistake in result.mistakes if mistake.kind == kind), None)
    if mistake_found is not None:
        return Finding(kind, describe(mistake_found), False, result.alternatives[kind])
    as_given = signed(lag) if kind == "lag" else RIGHT[kind]
    others = [candidate for candidate in result.candidates if candidate.mistake.kind == kind]
    cost = best.cost(level)
    alike = [other for other in others if other.cost(level) - ODDS < cost + AMBIGUOUS]
    if alike:
        names = dict.fromkeys(describe(other.mistake) for other in alike)
        return Finding(kind, as_given, True, tuple(names))
    share = min((other.fit.share for other in others), default=np.inf)
    sure = (
        f"every alternative raises the residual at least {share / best.fit.share:.1f}-fold"
        if np.isfinite(share) and share > 1.05 * best.fit.share
        else "every alternative needs implausible parameters"
        if np.isfinite(share)
        else "with every alternative the position is never known"
    )
    return Finding(kind, as_given, True, (), sure)


def _describe_fit(best: Candidate, machine: RotatingMachine) -> str:
    """Return the best values of the identifiable parameters, as text."""
    values, std = best.fit.values, best.fit.std
    names = ("R_s", " and ".join(machine.inductance_names), machine.flux_name)
    factors = [
        f"{name} {'fit' if ' and ' in name else 'fits'} at {np.exp(values[k]):.3g} times"
        for k, name in enumerate(names)
        if std[k] < IDENTIFIABLE and not (k == PSI and not machine.magnet_flux)
    ]
    sentences = [" and ".join(factors) + " the machine file's value"] if factors else []
    if machine.inverter_voltage is None and values[INVERTER] > CLEAR * std[INVERTER]:
        drop = values[INVERTER] * best.size
        sentences.append(f"the inverter loses about {drop:.2g} V per phase (inverter_voltage)")
    return "; ".join(sentences)


def _complete_scale(
    finding: Finding, best: Candidate, machine: RotatingMachine, fits: str, frame: str
) -> Finding:
    """Complete a finding on scales with the best values; return other findings unchanged."""
    if finding.kind != "scale":
        return finding
    words = finding.words
    if not finding.as_given and any(best.whole.loose):
        words = f"{words}: {_likely_value(best, machine)}"
        if frame == "dq" and abs(np.exp(best.fit.values[PSI]) / machine.n_p - 1) < NEAR_N_P:
            words += f"; is theta_e the mechanical angle? Then give --scale theta_e={machine.n_p}"
    remarks = [fits, finding.sure]
    if best.fit.std[R] >= IDENTIFIABLE:
        remarks.append("steps of load or speed would show R_s")
    return replace(finding, words=words, sure="; ".join(remark for remark in remarks if remark))


def _likely_value(best: Candidate, machine: RotatingMachine) -> str:
    """Return the likely value of a quantity that is wrong by an unknown factor."""
    values, loose = np.exp(best.fit.values), best.whole.loose
    k = min(np.flatnonzero(loose), key=lambda n: best.fit.std[n])
    if sum(loose) > 1:  # parameters scale with voltages and inversely with currents
        factor = 1 / values[k] if loose[PSI] else values[k]
        return f"multiply them by about {factor:.3g}, unless the file describes another machine"
    if k == PSI:
        return f"{values[k] * (machine.magnet_flux or 0.0):.3g} Wb fits"
    if k == R:
        return f"{values[k] * machine.R_s:.3g} Ω fits"
    return ", ".join(
        f"{name} = {values[k] * value:.3g} H fits"
        for name, value in dict(zip(machine.inductances, machine.L_dq, strict=True)).items()
    )
