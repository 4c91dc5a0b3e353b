"""Is a log what its user thinks? The usual mistakes, against what the machine's relation says.

Sign, phase order and lag change how well the relation holds. A scale does not: with voltages u/s
and currents i/c in place of u and i the same relation holds with R c/s and ψ_f/s. Scales are read
from the resistance and the magnet flux that fit, against those of the machine file.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import FluxobsError
from ..estimation.prepare import open_for, plain_for
from ..estimation.suspects import lively
from ..logs.log import Aligned, Log
from ..logs.read import Source
from ..machines import Machine, RotatingMachine, as_machine, rotating
from ..observers import LeastSquaresObserver
from ..observers.plain import MEMORY
from .fit import Fit, fit
from .identify import ALIKE_LIMIT, read_free, starting_values
from .pieces import LAGS, cut, smoothing_current, typical_length

#: Rows that are looked at.
ROWS = 20_000
#: A residual within this factor of the least one fits as well.
AS_GOOD = 1.5
#: One above this share of the flux fits nothing.
BAD = 0.25
#: Arrangements that are tried with other lags.
NEAR = 3.0
#: How well a machine file usually knows a cold resistance and a magnet flux (std of the logarithm).
SPREAD_R, SPREAD_PSI = 0.15, 0.08
#: Explanations whose squared distances differ by less than this are not told apart; one beyond
#: FAR² is none.
TOLD, FAR = 4.0, 3.0


class Hypothesis(NamedTuple):
    """A mistake of scale: what R and ψ then come out at, over those of the machine file."""

    words: str
    resistance: float
    psi: float


_2, _3, _P = float(np.sqrt(2)), float(np.sqrt(3)), float(np.sqrt(1.5))
AS_GIVEN = Hypothesis("scales are as given", 1, 1)
HYPOTHESES = (
    AS_GIVEN,
    Hypothesis("voltages are line to line (--frame line, or divide by √3)", _3, _3),
    Hypothesis("voltages are rms values (multiply by √2)", 1 / _2, 1 / _2),
    Hypothesis("currents are rms values (multiply by √2)", _2, 1),
    Hypothesis("voltages and currents are rms values (multiply both by √2)", 1, 1 / _2),
    Hypothesis("vectors are power-invariant (multiply voltages and currents by √(2/3))", 1, _P),
    Hypothesis("voltages alone are power-invariant (multiply by √(2/3))", _P, _P),
    Hypothesis("currents alone are power-invariant (multiply by √(2/3))", 1 / _P, 1),
    Hypothesis("R_s in the machine file is line to line (halve it)", 0.5, 1),
    Hypothesis("R_s in the machine file is half of a phase's (double it)", 2, 1),
    Hypothesis("psi_f in the machine file is an rms value (multiply by √2)", 1, _2),
    Hypothesis("psi_f in the machine file is line to line (divide by √3)", 1, 1 / _3),
)


class Arrangement(NamedTuple):
    """Sign of the current, its phases, and what is added to the lag."""

    sign: int
    phases: str
    lag: int


#: Whether a vector is mirrored, and by how much it is turned [°].
ORDERS: dict[str, tuple[bool, float]] = {
    "abc": (False, 0.0),
    "acb": (True, 0.0),
    "bac": (True, 120.0),
    "cba": (True, -120.0),
    "bca": (False, -120.0),
    "cab": (False, 120.0),
    "βα": (True, 90.0),
}
WORDS: dict[str, dict[Any, str]] = {
    "sign": {
        1: "the current's sign is right: positive into the machine",
        -1: "the current has the opposite sign (scale it by -1)",
    },
    "phases": {
        "abc": "currents and voltages have the same phase order",
        "acb": "the current's phases b and c are exchanged",
        "bac": "the current's phases a and b are exchanged",
        "cba": "the current's phases a and c are exchanged",
        "bca": "the current's phases are shifted by one (b c a)",
        "cab": "the current's phases are shifted by one (c a b)",
        "βα": "the current's α and β are exchanged",
    },
}
ARRANGED = Arrangement(1, "abc", 0)


@dataclass(frozen=True)
class Finding:
    """Of one kind of mistake.

    Attributes
    ----------
    kind, words : str
    as_given : bool
        What fits best, or as well, is what was given.
    others : tuple of str
        What this log cannot tell from it.
    sure : str
        How sure, where it is told.
    """

    kind: str
    words: str
    as_given: bool
    others: tuple[str, ...] = ()
    sure: str = ""

    def __str__(self) -> str:
        told = [f"this log cannot tell that from: {'; '.join(self.others)}"] if self.others else []
        sure = ". ".join([*told, *([self.sure] if self.sure else [])])
        mark = "" if self.as_given else "NOT as given: "
        return f"{self.kind}: {mark}{self.words} ({sure})"


@dataclass(frozen=True)
class Check:
    """Result of :func:`check`: findings, and the residual over the flux, as given and at best."""

    findings: tuple[Finding, ...]
    residual_given: float
    residual: float

    @property
    def sound(self) -> bool:
        """Nothing fits better than what was given."""
        return all(finding.as_given for finding in self.findings)

    def lines(self) -> list[str]:
        """A finding a line, and the residual."""
        given, best = self.residual_given, self.residual
        tail = (
            ""
            if best == given
            else f"; as given it is {given:.1%}"
            if given < np.inf
            else ("; as given the position is never known")
        )
        return [
            *(str(finding) for finding in self.findings),
            f"Residual of the machine's relation: {best:.1%} of the flux{tail}.",
        ]

    def __str__(self) -> str:
        return "\n".join(self.lines())


def check(log: Source, machine: Machine | str | Path, **layout: Any) -> Check:
    """Is a log what its user thinks? Tries the usual mistakes on its liveliest piece.

    Sign of the current, phase order, lag, and scales.

    Parameters
    ----------
    log : path, Log, Record, mapping of str to array, or (voltage, current)
        See :func:`fluxobs.read_log`.
    machine : Machine, or a path, or the name of a shipped machine
        One that turns.
    layout : optional
        As for :func:`fluxobs.read_log`.

    Raises
    ------
    FluxobsError
        Nothing fits: does the machine turn in this log?
    """
    given = rotating(as_machine(machine), "the check of a log")
    return check_log(open_for(log, given, **layout), given)


def check_log(log: Log, machine: RotatingMachine) -> Check:
    """The same of an opened log."""
    observer, scales = plain_for(log, machine, max(MEMORY, 10 * log.sample_time))
    smoothing = smoothing_current(machine, scales)
    fits: dict[Arrangement, Fit] = {}
    residuals: dict[Arrangement, float] = {}

    def attempt(keys: Iterable[Arrangement]) -> None:
        for lag, group in groupby(keys, key=lambda key: key.lag):
            part = lively(log.lagged(lag), ROWS)
            for key in group:
                found = _fit(key, part, machine, observer, smoothing)
                residuals[key] = np.inf
                if found is not None:
                    fits[key], residuals[key] = found

    attempt(Arrangement(sign, phases, 0) for sign in (1, -1) for phases in ORDERS)
    # A lag shifts the voltage by degrees: it can be left for those that fit more or less.
    near = [key for key in residuals if residuals[key] < NEAR * min(residuals.values())]
    attempt(key._replace(lag=lag) for lag in LAGS if lag for key in {ARRANGED, *near})
    best = min(residuals, key=lambda key: residuals[key])
    if not residuals[best] < BAD:
        raise FluxobsError(
            f"{log.path}: no arrangement of signs, phases and lag fits this machine. Does it "
            f"turn in this log, and are its inductances right within a factor of two?"
        )
    if residuals[ARRANGED] < AS_GOOD * residuals[best]:
        best = ARRANGED
    findings = [_arranged(kind, best, residuals, log.layout.lag) for kind in Arrangement._fields]
    findings.append(_scaled(fits[best], machine))
    return Check(tuple(findings), residuals[ARRANGED], residuals[best])


def _fit(
    key: Arrangement,
    part: Aligned,
    machine: RotatingMachine,
    observer: LeastSquaresObserver,
    smoothing: float,
) -> tuple[Fit, float] | None:
    """Fit of resistance, inverter and magnet, and its residual over the flux; None if the position
    is never known."""
    mirrored, turned = ORDERS[key.phases]
    z = np.where(np.isfinite(part.current), part.current, np.nan) @ [1, 1j]
    z = key.sign * np.exp(1j * np.radians(turned)) * (z.conj() if mirrored else z)
    current = np.stack([z.real, z.imag], axis=1)
    data = cut(observer, current, part.voltage[None], 0, machine.R_s, smoothing)
    if not data:
        return None
    size = typical_length(data, machine.position_inductance)
    start = starting_values(machine, data)
    if machine.magnets:
        start["psi_f"] = size  # whatever the scales
    found = fit(data, start, read_free(None, machine))
    size = found.values["psi_f"] or size
    return found, found.rms() / size if size > 0 else np.inf


def _arranged(
    kind: str, best: Arrangement, residuals: dict[Arrangement, float], lag: float
) -> Finding:
    value = getattr(best, kind)

    def words(x: Any) -> str:
        return f"{lag + x:+g}" if kind == "lag" else WORDS[kind][x]

    others = {
        getattr(key, kind): residual
        for key, residual in residuals.items()
        if getattr(key, kind) != value and key._replace(**{kind: value}) == best
    }
    same = tuple(words(x) for x in others if others[x] < AS_GOOD * residuals[best])
    least = min(others.values(), default=np.inf)
    sure = (
        f"else the residual is {least / residuals[best]:.1f} times as large"
        if np.isfinite(least)
        else "else the position is never known"
        if others
        else "nothing else comes near"
    )
    as_given = value == getattr(ARRANGED, kind)
    return Finding(kind, words(value), as_given, same, "" if same else sure)


def _scaled(found: Fit, machine: RotatingMachine) -> Finding:
    """Which mistake of scale leads from the machine file to what fits."""
    R, psi = found.values["R_s"], found.values["psi_f"]
    given_psi = machine.magnet_flux or None
    told_R = float(found.alike[0]) < ALIKE_LIMIT and found.std("R_s") < 0.2 * abs(R) and R > 0
    told_psi = given_psi is not None and psi > 0
    if not (told_R or told_psi):
        words = "this log cannot tell whether scales are as given"
        return Finding("scale", words, True, (), "steps of load or speed would show R_s")
    distances = {}
    for h in HYPOTHESES:
        if not told_psi and h.resistance == 1 and h != AS_GIVEN:
            continue  # of the magnet flux alone
        d = 0.0
        if told_R:
            d += (np.log(R / machine.R_s / h.resistance) / SPREAD_R) ** 2
        if told_psi and given_psi is not None:
            # without R the magnet flux holds what the resistive drop would
            spread = SPREAD_PSI if told_R else 2 * SPREAD_PSI
            d += (np.log(psi / given_psi / h.psi) / spread) ** 2
        distances[h] = float(d)
    best = min(distances, key=lambda h: distances[h])
    if distances[AS_GIVEN] < distances[best] + TOLD:
        best = AS_GIVEN
    parts = [f"R_s fits at {R / machine.R_s:.2f} times"] if told_R else []
    if told_psi and given_psi is not None:
        parts.append(f"psi_f at {psi / given_psi:.2f} times")
    sure = " and ".join(parts) + " what the machine file says" if parts else ""
    if not told_R:
        reason = "steps of load or speed would show R_s"
        sure = f"{sure}; {reason}" if sure else reason
    if distances[best] > FAR**2:
        words = "no usual mistake of scale explains what fits: check R_s and psi_f themselves"
        return Finding("scale", words, False, (), sure)
    others = [h.words for h in distances if h != best and distances[h] < distances[best] + TOLD]
    # The simplest first: the number in the machine file itself.
    words = best.words
    if told_psi and best.psi != 1 and (best.resistance == 1 or not told_R):
        words = f"psi_f in the machine file is off, or {words}"
    elif told_R and best.resistance != 1 and (best.psi == 1 or not told_psi):
        words = f"R_s in the machine file is off, or {words}"
    return Finding("scale", words, best == AS_GIVEN, tuple(others), sure)
