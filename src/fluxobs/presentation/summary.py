"""The summary of a run: one paragraph."""

from __future__ import annotations

import numpy as np

from ..checking.findings import Check
from ..estimation.learning import UNSEEN, learning_segments, parameters
from ..estimation.quality import times_of
from ..estimation.run import LogRun
from ..estimation.truth import TruthFit
from ..logs.quality.marks import MARKS
from ..logs.record import lag_in_words
from ..machines import RotatingMachine
from ..observers import ImmersionObserver
from ..observers.immersed import UNSEEN_BIAS

#: Marks that are no faults; number of stretches of a mark that summary and warnings name.
EVENTS = tuple(mark.name for mark in MARKS if not mark.fault)
NAMED_MARKS = 3
#: Contributions that the summary names.
BUDGET_ITEMS = 3
#: Least share of the rows of a reason that the summary names.
LEAST_SHARE = 0.001


def si(value: float, unit: str) -> str:
    """Format a value with three digits and an SI prefix."""
    for factor, prefix in ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n")):
        if abs(value) >= factor:
            return f"{value / factor:.3g} {prefix}{unit}"
    return f"0 {unit}" if value == 0 else f"{value:.2g} {unit}"


def paragraph(result: LogRun, checked: Check | None, truth: TruthFit | None) -> str:
    """Return the summary of a run; `checked` is the check of the run's log."""
    statistics, log = result.statistics, result.log
    opening = (
        f"{statistics.rows} samples, {statistics.rows * log.sample_time:.4g} s at "
        f"{1 / log.sample_time:.6g} Hz; {lag_in_words(log.layout.lag)}{_learnt_lag(result)}."
    )
    if isinstance(result.observer, ImmersionObserver):
        unknowns = " and ".join(result.observer.immersion.unknowns)
        opening += f" Unknowns: {unknowns}; memory {result.observer.memory:g} s."
    if statistics.first_valid is None:
        return " ".join([opening, "The position was never valid.", *_not_valid(result)])
    share = statistics.valid / statistics.rows
    sentences = [
        opening,
        *_choice(result),
        f"The position is valid on {share:.1%} of the rows, for the first time "
        f"{si(statistics.first_valid - statistics.start, 's')} after the start.",
        _drift(result),
        *_current_bias(result),
        *_flux(result),
        *_parameters(result),
        *_score(result, truth),
        *_not_valid(result),
        *_quality(result),
        *_budget(result),
        *([checked.untold] if checked is not None and checked.untold else []),
    ]
    return " ".join(sentences)


def _learnt_lag(result: LogRun) -> str:
    """Say how sure the learnt lag is."""
    decision = result.lag
    if decision is None:
        return ""
    if decision.decided:
        return ", as learnt from the log"
    weights = " or ".join(f"{lag:+g} ({share:.0%})" for lag, share in decision.weights.items())
    degrees = np.degrees(decision.position_difference)
    difference = (
        f" The two positions differ by {degrees:.2g}° rms, which is part of the standard "
        f"deviation; state --lag if you know it"
        if np.isfinite(degrees)
        else " State --lag if you know it"
    )
    return f". The log does not determine the lag: {weights}.{difference}"


def mean_of(result: LogRun, output: str) -> np.ndarray:
    """Return the mean of a vector output over the valid rows, (2,)."""
    ports = result.machine.ports
    return np.array([result.statistics.mean(f"{output}_{port}") for port in ports])


def _drift(result: LogRun) -> str:
    drift, machine = mean_of(result, "drift"), result.machine
    if isinstance(machine, RotatingMachine):
        size = float(np.hypot(*drift))
        return (
            f"Drift of the flux integral: ({drift[0]:+.4g}, {drift[1]:+.4g}) V in αβ, equivalent "
            f"to a voltage offset of {si(size, 'V')} or a current offset of "
            f"{si(size / machine.R_s, 'A')} through R_s."
        )
    offset = -np.linalg.solve(machine.B, drift)
    return (
        f"Drift of the flux integral: ({drift[0]:+.4g}, {drift[1]:+.4g}) V, equivalent to "
        f"voltage offsets of ({offset[0]:+.3g}, {offset[1]:+.3g}) V."
    )


def bias_is_seen(result: LogRun) -> bool:
    """Whether the record identifies the current bias; false if the bias is not an unknown."""
    observer = result.observer
    if not isinstance(observer, ImmersionObserver):
        return False
    std = _bias_std(result)
    return bool((std < UNSEEN_BIAS * observer.current_bias_prior).all())


def _bias_std(result: LogRun) -> np.ndarray:
    ports = result.machine.ports
    return np.array([result.statistics.mean(f"current_bias_{port}_std") for port in ports])


def _current_bias(result: LogRun) -> list[str]:
    if "current-bias" not in result.unknowns:
        return []
    if not bias_is_seen(result):
        return ["Current bias: not identifiable."]
    bias, std = mean_of(result, "current_bias"), _bias_std(result)
    assumed = (
        ", assuming that the voltage has no offset" if result.unknowns == ("current-bias",) else ""
    )
    return [
        f"Current bias: {bias[0]:+.4g} ± {std[0]:.2g} and {bias[1]:+.4g} ± {std[1]:.2g} A "
        f"(σ){assumed}."
    ]


def _flux(result: LogRun) -> list[str]:
    if result.plain is None or (result.adaptive is not None and not result.rotor.flux_moves):
        return []
    return [f"{result.rotor.length_name}: {si(result.statistics.mean('psi_f'), 'Wb')}."]


def _parameters(result: LogRun) -> list[str]:
    """Describe the parameters that the adaptive observer learnt, each with its assumed value."""
    adaptive, learnt = result.adaptive, result.learnt
    if adaptive is None or learnt is None:
        return []
    if not result.statistics.last_adapting:
        return ["No parameter was identified: the position was not valid for long enough."]
    machine = result.rotor
    sources = {
        "magnet flux": "given" if machine.magnet_flux else "guessed from the log",
        "resistance": "given",
        "inverter": "given" if machine.inverter_voltage is not None else "assumed",
    }
    identified, unidentified = [], []
    for parameter in parameters(adaptive, learnt):
        if parameter.told:
            # A value at its limit of zero may differ from zero by rounding.
            value = parameter.value if abs(parameter.value) > 1e-6 * parameter.std else 0.0
            quantity = f"{si(value, parameter.unit)} ± {si(parameter.std, parameter.unit)}"
            assumed = f"{si(parameter.assumed, parameter.unit)} {sources[parameter.name]}"
            identified.append(f"{parameter.name} {quantity} ({assumed})")
        else:
            unidentified.append(parameter.name)
    priors = (adaptive.L_d_std, adaptive.L_q_std)
    for n in range(2):
        std = learnt.inductance_std[n]
        if 0 < std <= UNSEEN * priors[n]:
            L, error = machine.L_dq[n], learnt.inductance_error[n]
            quantity = f"{si(L * (1 + error), 'H')} ± {si(L * std, 'H')}"
            identified.append(f"{machine.inductances[n]} {quantity} ({si(L, 'H')} given)")
    if adaptive.asymmetry_std > 0 and max(learnt.asymmetry_std) <= UNSEEN * adaptive.asymmetry_std:
        size, std = np.hypot(*learnt.asymmetry), max(learnt.asymmetry_std)
        identified.append(f"asymmetry of the phases {100 * size:.2g} ± {100 * std:.1g} %")
    segments = learning_segments(result.log)
    origin = "from the whole log"
    if len(segments) > 1:
        origin = "from segments that are spread over the log"
    if result.causal:
        origin = "by the end"
    sentences = [f"Identified {origin}: {', '.join(identified)}."] if identified else []
    if unidentified:
        sentences.append(f"Not identifiable from this log: {', '.join(unidentified)}.")
    return sentences


def _not_valid(result: LogRun) -> list[str]:
    """Say why the observer of a drive held back its position."""
    rows, reasons = result.statistics.rows, result.statistics.not_valid
    shares = [
        f"{reason} {count / rows:.1%}"
        for reason, count in sorted(reasons.items(), key=lambda entry: -entry[1])
        if count >= LEAST_SHARE * rows
    ]
    return [f"Not valid: {', '.join(shares)}."] if shares else []


def _quality(result: LogRun) -> list[str]:
    """Count the rows with marks that are no faults."""
    marked = result.statistics.quality.marked
    events = [
        f"{name} on {marked[name].rows} rows ("
        f"{times_of(marked[name].stretches, marked[name].count, NAMED_MARKS)})"
        for name in EVENTS
        if name in marked
    ]
    return [f"Marks: {'; '.join(events)}."] if events else []


def _budget(result: LogRun) -> list[str]:
    """Name the largest contributions to the standard deviation of the position."""
    budget = result.budget
    if budget is None or not budget.rows:
        return []
    largest = [
        f"{contribution.name} {np.degrees(contribution.std):.2g}°"
        for contribution in budget.contributions[:BUDGET_ITEMS]
    ]
    return [
        f"Standard deviation of the position: {np.degrees(budget.std):.2g}° rms on valid rows, "
        f"mostly from {', '.join(largest)}.",
        budget.advice,
    ]


def _choice(result: LogRun) -> list[str]:
    """Name the unknowns of a causal run if they were chosen from the machine."""
    if not result.automatic or result.adaptive is None or result.budget is not None:
        return []
    return [f"Estimated as well: {', '.join(result.unknowns)}."]


def _score(result: LogRun, truth: TruthFit | None) -> list[str]:
    statistics, position = result.statistics, result.machine.position_output
    wrong_turns = truth is not None and truth.wrong_turns
    if not statistics.scored or wrong_turns:
        return _fitted(result, truth)
    mean, factor = statistics.error / statistics.scored, position.factor
    angle = position.unit == "°"

    def formatted(value: float) -> str:
        return f"{factor * value:.2f}°" if angle else f"{factor * value:.3g}{position.unit}"

    return [
        f"Position error against the true {'angle' if angle else 'position'} on "
        f"{statistics.scored} valid rows: {formatted(statistics.rms_error)} rms, "
        f"{formatted(statistics.error_max)} at most, mean {formatted(mean)}.",
        *_fitted(result, truth),
    ]


def _fitted(result: LogRun, truth: TruthFit | None) -> list[str]:
    """Describe the errors of the truth channel, and the position error without these errors."""
    if truth is None or not truth.told:
        return []
    columns = "" if result.log.true is None else " ".join(result.log.true.columns)
    text = f"Channel {truth.channel} ({columns}), fitted to the estimate: "
    text += "; ".join(truth.words) + "."
    if not np.isfinite(truth.rms):
        return [text]
    if truth.channel.startswith("speed"):
        return [f"{text} The speeds differ by {truth.rms:.3g} rad/s rms, {truth.most:.3g} at most."]
    remaining = f"{np.degrees(truth.rms):.2f}° rms, {np.degrees(truth.most):.2f}° at most"
    subject = "The edges scatter by" if truth.channel == "hall" else "The remaining error is"
    return [f"{text} {subject} {remaining}."]
