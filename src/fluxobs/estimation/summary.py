"""What a run found, in one readable paragraph."""

from __future__ import annotations

import numpy as np

from ..checking.findings import Check
from ..logs.record import lag_in_words
from ..machines import RotatingMachine
from ..observers import ImmersionObserver
from ..observers.immersed import UNSEEN_BIAS
from .learning import UNSEEN, learning_parts, parameters
from .run import LogRun
from .truth import TruthFit


def si(value: float, unit: str) -> str:
    """Three digits and an SI prefix."""
    for factor, prefix in ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n")):
        if abs(value) >= factor:
            return f"{value / factor:.3g} {prefix}{unit}"
    return f"0 {unit}" if value == 0 else f"{value:.2g} {unit}"


def paragraph(result: LogRun, found: Check | None, truth: TruthFit | None) -> str:
    """The summary of a run whose log was checked."""
    statistics, log = result.statistics, result.log
    head = (
        f"{statistics.rows} samples, {statistics.rows * log.sample_time:.4g} s at "
        f"{1 / log.sample_time:.6g} Hz; {lag_in_words(log.layout.lag)}."
    )
    if isinstance(result.observer, ImmersionObserver):
        unknowns = " and ".join(result.observer.immersion.unknowns)
        head += f" Unknown: {unknowns}; memory {result.observer.memory:g} s."
    if statistics.first_valid is None:
        return f"{head} The position was never known."
    share = statistics.valid / statistics.rows
    sentences = [
        head,
        *_choice(result),
        f"The position is valid on {share:.1%} of the rows, first "
        f"{si(statistics.first_valid - statistics.start, 's')} after the start.",
        _drift(result),
        *_current_bias(result),
        *_flux(result),
        *_parameters(result),
        *_score(result, truth),
        *([found.untold] if found is not None and found.untold else []),
    ]
    return " ".join(sentences)


def mean_of(result: LogRun, output: str) -> np.ndarray:
    """Mean of a vector output over the valid rows, (2,)."""
    ports = result.machine.ports
    return np.array([result.statistics.mean(f"{output}_{port}") for port in ports])


def _drift(result: LogRun) -> str:
    drift, machine = mean_of(result, "drift"), result.machine
    if isinstance(machine, RotatingMachine):
        size = float(np.hypot(*drift))
        return (
            f"The flux integral would drift by ({drift[0]:+.4g}, {drift[1]:+.4g}) V in αβ: as much "
            f"as a voltage offset of {si(size, 'V')}, or a current offset of "
            f"{si(size / machine.R_s, 'A')} through R_s."
        )
    offset = -np.linalg.solve(machine.B, drift)
    return (
        f"The flux integral would drift by ({drift[0]:+.4g}, {drift[1]:+.4g}) V, as much as "
        f"voltage offsets of ({offset[0]:+.3g}, {offset[1]:+.3g}) V."
    )


def bias_is_seen(result: LogRun) -> bool:
    """Whether the record revealed the current bias, if that is an unknown."""
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
        return ["Current bias: not seen."]
    bias, std = mean_of(result, "current_bias"), _bias_std(result)
    assumed = ", if the voltage has no offset" if result.unknowns == ("current-bias",) else ""
    return [
        f"Current bias: {bias[0]:+.4g} ± {std[0]:.2g} and {bias[1]:+.4g} ± {std[1]:.2g} A "
        f"(σ){assumed}."
    ]


def _flux(result: LogRun) -> list[str]:
    if result.adaptive is not None or result.plain is None:
        return []
    return [f"{result.rotor.length_name}: {si(result.statistics.mean('psi_f'), 'Wb')}."]


def _parameters(result: LogRun) -> list[str]:
    """What the adaptive observer has learnt, each with the value assumed before."""
    adaptive, learnt = result.adaptive, result.learnt
    if adaptive is None or learnt is None:
        return []
    if not result.statistics.found:
        return ["No parameter was found: the position was not known for long enough."]
    machine = result.rotor
    sources = {
        "magnet flux": "given" if machine.magnet_flux else "guessed from the log",
        "resistance": "given",
        "inverter": "given" if machine.inverter_voltage is not None else "assumed",
    }
    told, untold = [], []
    for one in parameters(adaptive, learnt):
        if one.told:
            held = one.value if abs(one.value) > 1e-6 * one.std else 0.0  # at a limit
            value = f"{si(held, one.unit)} ± {si(one.std, one.unit)}"
            told.append(f"{one.name} {value} ({si(one.assumed, one.unit)} {sources[one.name]})")
        else:
            untold.append(one.name)
    priors = (adaptive.L_d_std, adaptive.L_q_std)
    for n in range(2):
        std = learnt.inductance_std[n]
        if 0 < std <= UNSEEN * priors[n]:
            L, off = machine.L_dq[n], learnt.inductance_error[n]
            found = f"{si(L * (1 + off), 'H')} ± {si(L * std, 'H')}"
            told.append(f"{machine.inductances[n]} {found} ({si(L, 'H')} given)")
    if adaptive.asymmetry_std > 0 and max(learnt.asymmetry_std) <= UNSEEN * adaptive.asymmetry_std:
        size, std = np.hypot(*learnt.asymmetry), max(learnt.asymmetry_std)
        told.append(f"asymmetry of the phases {100 * size:.2g} ± {100 * std:.1g} %")
    parts = learning_parts(result.log)
    whole = "From the whole log"
    if len(parts) > 1:
        whole = f"From {sum(last - first for first, last in parts)} rows, evenly spread"
    when = "At the end" if result.causal else whole
    text = [f"{when}: {', '.join(told)}."] if told else []
    if untold:
        text.append(f"The log does not tell {' and '.join(untold)}.")
    return text


def _choice(result: LogRun) -> list[str]:
    """What was taken as unknown, if the log decided."""
    if not result.automatic:
        return []
    if result.adaptive is not None:
        return [f"Taken as unknown, as the log tells them: {', '.join(result.unknowns)}."]
    return ["Taken as unknown: the drift; the log does not ask for more."]


def _score(result: LogRun, truth: TruthFit | None) -> list[str]:
    statistics, position = result.statistics, result.machine.position_output
    wrong = truth is not None and truth.wrong_turns
    if not statistics.scored or wrong:
        return _fitted(result, truth)
    mean, factor = statistics.error / statistics.scored, position.factor
    angle = position.unit == "°"

    def told(value: float) -> str:
        return f"{factor * value:.2f}°" if angle else f"{factor * value:.3g}{position.unit}"

    return [
        f"Against the true {'angle' if angle else 'position'}, on {statistics.scored} valid rows: "
        f"position error {told(statistics.rms_error)} rms, {told(statistics.error_max)} at most, "
        f"mean {told(mean)}.",
        *_fitted(result, truth),
    ]


def _fitted(result: LogRun, truth: TruthFit | None) -> list[str]:
    """What the truth channel is off by, and what is left of the error without that."""
    if truth is None or not truth.told:
        return []
    columns = "" if result.log.true is None else " ".join(result.log.true.columns)
    text = f"Of the channel {truth.channel} ({columns}), fitted to the estimate: "
    text += "; ".join(truth.words) + "."
    if not np.isfinite(truth.rms):
        return [text]
    if truth.channel.startswith("speed"):
        return [f"{text} The speeds differ by {truth.rms:.3g} rad/s rms, {truth.most:.3g} at most."]
    left = f"{np.degrees(truth.rms):.2f}° rms, {np.degrees(truth.most):.2f}° at most"
    what = "The edges scatter by" if truth.channel == "hall" else "Without these the error is"
    return [f"{text} {what} {left}."]
