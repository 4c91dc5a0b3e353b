"""The search for what explains a log best."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..logs.log import Log
from ..logs.scales import Scales, measure_scales
from ..machines import RotatingMachine
from ..machines.model.frames import PHASE_CURRENTS
from ..machines.model.inverter import SMOOTHING
from .columns import columns
from .findings import UNSEEN, Check, Finding
from .mistakes import (
    AS_GIVEN,
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
    one_inverted,
    together,
)
from .relation import INVERTER, MODEL, PSI, R, RelationFit, RelationResidual, positions, rows
from .segments import Stretches, stretches
from .truth import truth

#: Explanations whose costs differ by less are not told apart: two standard deviations.
TOLD = 4.0
#: A residual above this share of the flux does not fit at all.
BAD = 0.2
#: Findings that leave nothing to be tried.
FIRST = ("columns", "angle")
#: A parameter is identifiable if its logarithm has a smaller standard deviation.
KNOWN = 0.1
#: A magnet flux that is n_p times too large to within this share says that the angle is mechanical.
ALMOST = 0.05
#: An inverter voltage is identifiable beyond this many standard deviations.
CLEAR = 3.0
#: Mistakes that are looked for one upon another.
DEEPEST = 3
#: Where an unknown factor is looked for, as a logarithm: up to ten thousand, in steps of two.
FACTORS = np.linspace(-9.1, 9.1, 27)
#: A voltage of less than this many resistive drops is no more than that, standstill; of less than
#: the other, a mistake.
STANDING, IMPOSSIBLE = 1.5, 0.3


@dataclass(frozen=True)
class Tried:
    """A mistake put right, and what then fits."""

    mistake: Mistake
    whole: Mistake  # with those that were found before
    fit: RelationFit
    odds: float
    size: float  # of the voltage [V]

    def cost(self, level: float) -> float:
        return self.fit.misfit / level + self.fit.distance + self.odds


@dataclass(frozen=True)
class End:
    """Where a search ends.

    Attributes
    ----------
    given, best : Tried
    found : list of Mistake
    instead : dict
        What may be in its place, by kind.
    around : list of Tried
        The best, and every other mistake upon it.
    level : float
        What misfits are divided by.
    """

    given: Tried
    best: Tried
    found: list[Mistake]
    instead: dict[str, tuple[str, ...]]
    around: list[Tried]
    level: float


def alternatives(machine: RotatingMachine, log: Log) -> list[Mistake]:
    """Mistakes that are possible for this machine and log, the simpler ones first."""
    frame = log.frame
    measured = "".join(name[-1] for name in PHASE_CURRENTS if name in log.names)
    both = [
        replace(together(sign, phases), kind="phases", words=f"{phases.words}, and {sign.words}")
        for sign in SIGN
        for phases in PHASES
    ]
    scales = [one for one in [*SCALES, *FACTOR] if machine.magnets or not one.only_flux]
    if not machine.magnets:  # its currents and voltages are told only together
        scales.remove(FACTOR[-1])
    file = [one for one in FILE if machine.magnets or not one.only_flux]
    frames = FRAME if frame == "alphabeta" else []
    line = {"abc": LINE, "line": NEUTRAL}.get(frame, [])
    single = one_inverted(measured) if len(measured) == 2 else []
    return [*file, *SIGN, *single, *PHASES, *LAG, *frames, *line, *scales, *both]


class Search:
    """All that is tried on one set of stretches."""

    def __init__(self, machine: RotatingMachine, data: Stretches, scales: Scales):
        self.machine, self.data, self.scales = machine, data, scales
        rated = machine.rated_current or scales.current
        self.smoothing = machine.inverter_current or SMOOTHING * rated
        self.relations: dict[Any, RelationResidual] = {}

    def again(self, tried: Tried, others: list[Tried]) -> Tried:
        """Fit once more from where the best of the others with the same vectors ended."""
        same = [one for one in others if one.whole.arrangement == tried.whole.arrangement]
        best = min(same, key=lambda one: one.fit.misfit, default=tried)
        if not best.fit.misfit < tried.fit.misfit:
            return tried
        relation = self.relations[tried.whole.arrangement]
        found = relation.fit(tried.whole.prior(self._given(relation)), best.fit.values)
        worse = found.misfit + found.distance >= tried.fit.misfit + tried.fit.distance
        return tried if worse else replace(tried, fit=found)

    def _given(self, relation: RelationResidual) -> float:
        return (self.machine.inverter_voltage or 0.0) / (relation.data.size + 1e-300)

    def attempt(self, before: Mistake, mistake: Mistake, odds: float) -> Tried:
        """Put a mistake right on top of those before, and fit."""
        whole = together(before, mistake)
        key = whole.arrangement
        if key not in self.relations:
            made = rows(
                self.data,
                whole.voltage(self.data.voltage[whole.lag]),
                whole.current(self.data.current),
                self.smoothing,
            )
            self.relations[key] = RelationResidual(self.machine, made, self.scales.current_noise)
        relation = self.relations[key]
        prior = whole.prior(self._given(relation))
        start, direction = prior.mean, np.array([*whole.loose, 0.0])
        if direction[:2].any():
            start = min((prior.mean + s * direction for s in FACTORS), key=relation.misfit)
        fit = relation.fit(prior, start)
        more = ODDS if mistake.kind else 0.0
        return Tried(mistake, whole, fit, odds + more, relation.data.size)

    def run(self, tries: list[Mistake], progress: Callable[[int, int], Any] | None) -> End:
        """Put right what explains the log best, one mistake upon another."""
        best = given = self.attempt(AS_GIVEN, AS_GIVEN, 0.0)
        found: list[Mistake] = []
        instead: dict[str, tuple[str, ...]] = {}
        while True:
            around = [best]
            for n, mistake in enumerate(tries):
                if mistake.kind not in {one.kind for one in found}:
                    around.append(self.attempt(best.whole, mistake, best.odds))
                if progress is not None:
                    progress(len(found) * len(tries) + n + 1, (len(found) + 1) * len(tries))
            around = [self.again(one, around) for one in around]
            best = around[0]
            given = best if not found else given
            share = min(one.fit.share for one in around)
            level = max(1.0, (share / MODEL) ** 2)
            least = min(one.cost(level) for one in around)
            if best.cost(level) <= least or len(found) == DEEPEST:
                return End(given, best, found, instead, around, level)
            alike = [one for one in around[1:] if one.cost(level) < least + TOLD]
            best = alike[0]  # the simplest
            found.append(best.mistake)
            instead[best.mistake.kind] = tuple(
                dict.fromkeys(one.mistake.words for one in alike[1:])
            )


def check_log(
    log: Log,
    machine: RotatingMachine,
    progress: Callable[[int, int], Any] | None = None,
    scales: Scales | None = None,
) -> Check:
    """Check a log that is open; its scales are measured if they are not given."""
    log = log.less_inverter(None)
    seen = columns(log)
    if any(finding.kind in FIRST for finding in seen):
        return Check(tuple(seen), None, None, ("Mend that first; nothing else was tried.",))
    measured = measure_scales(log) if scales is None else scales
    tries = alternatives(machine, log)
    search = Search(machine, stretches(log, machine), measured)
    end = search.run(tries, progress)
    if (vectors := (end.best.whole.current, end.best.whole.voltage)) != (SAME, SAME):
        # Wrong vectors choose stretches by an EMF that is none.
        search = Search(machine, stretches(log, machine, *vectors), measured)
        end = search.run(tries, progress)
    given, best, found, around = end.given, end.best, end.found, end.around
    if not best.fit.share < BAD:
        return _nothing_fits(log, machine, search, seen, given)
    findings = [
        _finding(kind, end, log.layout.lag, machine.flux_name)
        for kind in KINDS
        if any(mistake.kind == kind for mistake in tries)
    ]
    fits = _fits(best, machine)
    findings = [_scaled(one, best, machine, fits, log.current_frame) for one in findings]
    true = log.true
    notes = (UNSEEN,) if true is None or true.channel.startswith("speed") else ()
    data = search.data
    if true is not None and not true.guessed and true.angular and data.truth is not None:
        at = positions(data.current.shape[1])
        lags = {one.mistake.lag: one.fit for one in around if one.mistake.kind == "lag"}
        tried = {0: best.fit} | (lags if not found else {})
        findings += truth(true.channel, machine, data, tried, at, log.layout.lag)
    return Check((*seen, *findings), given.fit.share, best.fit.share, notes, fits)


def _nothing_fits(
    log: Log, machine: RotatingMachine, search: Search, seen: list[Finding], given: Tried
) -> Check:
    data = search.data
    drops = float(
        np.median(np.abs(data.voltage[0])) / np.median(machine.R_s * np.abs(data.current))
    )
    words = "no arrangement of signs, phases, lag and scales fits this machine" + (
        f": its R_s would take {1 / drops:.3g} times the voltage in this log. Are currents in mA "
        f"or counts, or is R_s in mΩ?"
        if drops < IMPOSSIBLE
        else ": the voltage is hardly more than the resistive drop, as at standstill. Does it turn "
        "in this log?"
        if drops < STANDING
        else ". Does it turn in this log, and are kind, R_s and inductances those of this machine?"
    )
    other = _other_kind(machine, search)
    if other is not None:
        words = other
    return Check((*seen, Finding("machine", words, False)), given.fit.share, given.fit.share)


def _other_kind(machine: RotatingMachine, search: Search) -> str | None:
    """Whether a machine with, or without, magnets would fit."""
    from ..machines import SurfacePMSM

    if machine.magnets:
        return None
    L_d, L_q = machine.L_dq
    for inductance in (L_q, L_d, L_q / 10):
        magnet = SurfacePMSM(R_s=machine.R_s, L_s=inductance, n_p=machine.n_p)
        tried = Search(magnet, search.data, search.scales)
        loose = Mistake("machine", "", loose=(0, 1, 0))
        fit = tried.attempt(AS_GIVEN, loose, 0.0).fit
        if fit.share < BAD / 4:
            return (
                f"this kind of machine, {machine.kind}, does not fit, but one with a magnet does "
                f"(surface-pmsm, psi_f about {np.sqrt(np.mean(np.abs(fit.position) ** 2)):.3g} Wb)"
            )
    return None


def _finding(kind: str, end: End, lag: float, flux_name: str) -> Finding:
    best, around, level = end.best, end.around, end.level

    def words(mistake: Mistake) -> str:
        if kind == "lag":
            return f"{lag + mistake.lag:+g}"
        return mistake.words.replace("psi_f", flux_name)

    taken = next((mistake for mistake in end.found if mistake.kind == kind), None)
    if taken is not None:
        return Finding(kind, words(taken), False, end.instead[kind])
    right = f"{lag:+g}" if kind == "lag" else RIGHT[kind]
    others = [one for one in around if one.mistake.kind == kind]
    cost = best.cost(level)
    same = [one for one in others if one.cost(level) - ODDS < cost + TOLD]
    if same:
        names = dict.fromkeys(words(one.mistake) for one in same)
        return Finding(kind, right, True, tuple(names))
    least = min((one.fit.share for one in others), default=np.inf)
    sure = (
        f"else the residual is {least / best.fit.share:.1f} times as large"
        if np.isfinite(least) and least > 1.05 * best.fit.share
        else "anything else would need unlikely parameters"
        if np.isfinite(least)
        else "else the position is never known"
    )
    return Finding(kind, right, True, (), sure)


def _fits(best: Tried, machine: RotatingMachine) -> str:
    """The parameters that fit, if they are told."""
    values, std = best.fit.values, best.fit.std
    names = ("R_s", " and ".join(machine.inductance_names), machine.flux_name)
    told = [
        f"{name} {'fit' if ' and ' in name else 'fits'} at {np.exp(values[k]):.3g} times"
        for k, name in enumerate(names)
        if std[k] < KNOWN and not (k == PSI and not machine.magnet_flux)
    ]
    parts = [" and ".join(told) + " what the machine file says"] if told else []
    if machine.inverter_voltage is None and values[INVERTER] > CLEAR * std[INVERTER]:
        drop = values[INVERTER] * best.size
        parts.append(f"the inverter loses about {drop:.2g} V a phase (inverter_voltage)")
    return "; ".join(parts)


def _scaled(
    finding: Finding, best: Tried, machine: RotatingMachine, fits: str, frame: str
) -> Finding:
    """Say of a finding on scales what fits."""
    if finding.kind != "scale":
        return finding
    words = finding.words
    if not finding.as_given and any(best.whole.loose):
        words = f"{words}: {_likely(best, machine)}"
        if frame == "dq" and abs(np.exp(best.fit.values[PSI]) / machine.n_p - 1) < ALMOST:
            words += f"; is theta_e the mechanical angle? Then --scale theta_e={machine.n_p}"
    parts = [fits, finding.sure]
    if best.fit.std[R] >= KNOWN:
        parts.append("steps of load or speed would show R_s")
    return replace(finding, words=words, sure="; ".join(part for part in parts if part))


def _likely(best: Tried, machine: RotatingMachine) -> str:
    """The likely value of what is off by an unknown factor."""
    values, loose = np.exp(best.fit.values), best.whole.loose
    k = min(np.flatnonzero(loose), key=lambda n: best.fit.std[n])
    if sum(loose) > 1:  # of voltages the parameters have the scale, of currents its inverse
        factor = 1 / values[k] if loose[PSI] else values[k]
        return f"multiply them by about {factor:.3g}, or is the file that of another machine?"
    if k == PSI:
        return f"{values[k] * (machine.magnet_flux or 0.0):.3g} Wb fits"
    if k == R:
        return f"{values[k] * machine.R_s:.3g} Ω fits"
    return ", ".join(
        f"{name} = {values[k] * value:.3g} H fits"
        for name, value in dict(zip(machine.inductances, machine.L_dq, strict=True)).items()
    )
