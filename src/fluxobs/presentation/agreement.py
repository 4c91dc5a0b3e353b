"""Findings of a check that the estimate of the same log contradicts.

A check fits a few segments with R_s, the inductances, the magnet flux and the inverter voltage. The
estimate knows more: lag, offsets, gains, iron loss and harmonics, over the whole log. What the
check takes for a wrong inductance or lag is often one of these. Where the estimate explains the
log, its values count.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..checking.findings import Check, Finding
from ..checking.mistakes import RIGHT
from ..core.arrays import Array
from ..estimation.course import CONVERGED_MISFIT
from ..estimation.lag import UNDECIDED
from ..estimation.learning import parameters
from ..estimation.run import LogRun
from ..logs.record import signed

#: Kinds of findings that exchange, turn or reverse vectors.
ARRANGING = ("sign", "phases", "frame")
#: Values agree within this many standard deviations; that of a check's logarithms is at least this.
AGREEMENT, CHECK_STD = 3.0, 0.1
#: The estimate knows R_s and the flux if its standard deviation is below half of the usual prior;
#: inductances have a narrow prior.
TOLD = (0.25, np.inf, 0.12)
#: Least step of an inductance that its prior may have held back, as a share.
HELD_BACK = 0.05
#: A check's finding of another lag than stated stands if the whole log leans the same way, by this
#: many standard deviations.
LEANS = 0.9
#: A stated lag is wrong if the lag that the log tells is another one, off by this many standard
#: deviations.
CONTRADICTED = 3.0
#: A check changes a value if its logarithm is larger than this.
CHANGED = 0.15


def fits(result: LogRun) -> bool:
    """Whether the log fits the machine; the position need not be valid."""
    budget = result.budget
    return (
        budget is not None
        and not budget.contradiction
        and not (result.examined is not None and result.examined.rearranged)
        and budget.misfit < CONVERGED_MISFIT
    )


def explains(result: LogRun) -> bool:
    """Whether the estimate explains the log, with valid positions."""
    return fits(result) and result.statistics.valid > 0


def agreed(checked: Check, result: LogRun) -> Check:
    """Return the check without the findings that the estimate contradicts."""
    findings = checked.findings
    named = result.budget is not None and bool(result.budget.contradiction)
    if (named or explains(result)) and not checked.rearranged:
        findings = tuple(_as_given(f) if f.kind in ARRANGING else f for f in findings)
    if explains(result):
        findings = tuple(_agreed(f, checked, result) for f in findings)
    return replace(checked, findings=findings)


def _as_given(finding: Finding) -> Finding:
    """Return the finding that the vectors are as given."""
    if finding.as_given:
        return finding
    return Finding(finding.kind, RIGHT[finding.kind], True, (), "other vectors fit little better")


def _agreed(finding: Finding, checked: Check, result: LogRun) -> Finding:
    if finding.kind == "scale" and finding.as_given and _all_told(result):
        return Finding("scale", RIGHT["scale"], True)
    if finding.kind == "lag":
        return _agreed_lag(finding, result)
    if finding.as_given and not finding.others:
        return finding
    if finding.kind == "scale" and not finding.as_given and not _values_agree(checked, result):
        return Finding("scale", RIGHT["scale"], True)
    return finding


def _agreed_lag(finding: Finding, result: LogRun) -> Finding:
    """Return what the whole log says about the lag, which knows more than the segments."""
    lag, decision = result.log.layout.lag, result.lag
    others: tuple[str, ...] = ()
    if decision is None:
        best, std = result.fractional_lag or (lag, 0.0)
        nearest = round(best)
        leans = (best - lag) * np.sign(float(finding.words) - lag) if finding.words else 0.0
        if not finding.as_given and leans > LEANS * std:
            return finding
        if nearest != lag and abs(best - lag) > CONTRADICTED * std:
            return Finding("lag", signed(nearest), False)
        if finding.as_given and finding.others:
            return finding  # the estimate did not try these
    elif finding.as_given or float(finding.words) in decision.weights:
        others = tuple(
            signed(other)
            for other, weight in decision.weights.items()
            if other != lag and weight > UNDECIDED
        )
    else:
        return finding  # the estimate did not try this lag
    return Finding("lag", signed(lag), True, others, "the whole log fits with it")


def _all_told(result: LogRun) -> bool:
    """Whether the log identifies every parameter that the observer learns."""
    if result.adaptive is None or result.learnt is None:
        return False
    return all(parameter.told for parameter in parameters(result.adaptive, result.learnt))


def _values_agree(checked: Check, result: LogRun) -> bool:
    """Whether R_s, the inductances and the flux of a check are those of the estimate."""
    learnt, machine = result.learnt, result.rotor
    if learnt is None or checked.factors is None:
        return False
    psi = machine.magnet_flux
    stds = [std for std in learnt.inductance_std if std > 0] or [0.0]
    ratios = [learnt.resistance / machine.R_s, 1 + learnt.inductance_error[0]]
    errors = [learnt.resistance_std / machine.R_s, max(stds)]
    found = [*checked.factors[:2]]
    if psi:
        ratios.append(learnt.psi_f / psi)
        errors.append(learnt.psi_f_std / psi)
        found.append(checked.factors[2])
    own: Array = np.maximum(np.array(ratios), 1e-6)
    std = np.hypot(np.array(errors) / own, CHECK_STD)
    changed = np.abs(np.log(np.array(found))) > CHANGED
    agree = np.abs(np.log(np.array(found) / own)) < AGREEMENT * std
    told = np.array(errors) / own < np.array(TOLD)[: len(own)]
    # The prior holds an inductance back: a step towards the value of the check agrees with it.
    step, towards = own[1] - 1, found[1] - 1
    agree[1] |= step * towards > 0 and abs(step) > HELD_BACK
    return bool((agree | ~told)[changed].all())
