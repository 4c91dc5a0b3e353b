"""The summary of a run: a short table of labels and values, the position first."""

from __future__ import annotations

import numpy as np

from ..checking.findings import UNSEEN as UNSEEN_TURN
from ..checking.findings import Check
from ..estimation.columns import is_position
from ..estimation.learning import UNSEEN, learning_segments, parameters
from ..estimation.quality import times_of
from ..estimation.run import LogRun
from ..estimation.truth import TruthFit
from ..logs.quality.marks import MARKS
from ..logs.record import signed
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


#: Factors and their SI prefixes.
PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))


def si(value: float, unit: str) -> str:
    """Format a value with three digits and an SI prefix."""
    for factor, prefix in PREFIXES:
        if abs(value) >= factor:
            return f"{value / factor:.3g} {prefix}{unit}"
    return f"0 {unit}" if value == 0 else f"{value:.2g} {unit}"


#: A row of the summary: label and value.
Row = tuple[str, str]
#: Revolutions per minute of one radian per second.
RPM = 30 / np.pi


def summary_rows(result: LogRun, checked: Check | None, truth: TruthFit | None) -> list[Row]:
    """Return the rows of the summary; `checked` is the check of the run's log."""
    return [
        _log(result),
        *_position(result, truth),
        *_speed(result),
        *_lag(result),
        *_unknowns(result),
        *_drift(result),
        *_current_bias(result),
        *_flux(result),
        *_parameters(result),
        *_truth_errors(result, truth),
        *_quality(result),
        *_next(result, checked),
    ]


def as_text(rows: list[Row]) -> str:
    """Return rows as lines with aligned values."""
    width = max(len(label) for label, _ in rows)
    return "\n".join(f"{label}{' ' * (width - len(label))}  {value}" for label, value in rows)


def _log(result: LogRun) -> Row:
    statistics, log = result.statistics, result.log
    duration = si(statistics.rows * log.sample_time, "s")
    return "log", (
        f"{log.path.name}: {statistics.rows} rows, {duration} at {1 / log.sample_time:.6g} Hz"
    )


def _position(result: LogRun, truth: TruthFit | None) -> list[Row]:
    """Return the rows on the position: where it is valid, its standard deviation, its error."""
    statistics = result.statistics
    reasons = _not_valid(result)
    if statistics.first_valid is None:
        return [("position", "never valid"), *reasons]
    first = statistics.first_valid - statistics.start
    valid = f"valid on {statistics.valid / statistics.rows:.1%} of the rows"
    if first > 0:
        valid += f", first after {si(first, 's')}"
    return [("position", valid), *reasons, *_budget(result), *_score(result, truth)]


def _not_valid(result: LogRun) -> list[Row]:
    """Say why rows have no valid position."""
    rows, reasons = result.statistics.rows, result.statistics.not_valid
    shares = [
        f"{reason} {count / rows:.1%}"
        for reason, count in sorted(reasons.items(), key=lambda entry: -entry[1])
        if count >= LEAST_SHARE * rows
    ]
    if not shares:
        return []
    columns = result.statistics.thin.columns()
    lost = columns["valid"] == 0
    if result.budget is not None and result.statistics.valid and lost.any():
        speeds = RPM * np.abs(columns["speed_e"]) / result.rotor.n_p
        there, usual = float(np.median(speeds[lost])), float(np.median(speeds[~lost]))
        shares.append(f"median speed there {there:.0f} rpm, on valid rows {usual:.0f} rpm")
    return [("  not valid", ", ".join(shares))]


def _budget(result: LogRun) -> list[Row]:
    """Name the largest contributions to the standard deviation of the position."""
    budget = result.budget
    if budget is None or not budget.rows:
        return []
    largest = ", ".join(
        f"{contribution.name} {np.degrees(contribution.std):.2g}°"
        for contribution in budget.contributions[:BUDGET_ITEMS]
    )
    return [("  σ", f"{np.degrees(budget.std):.2g}° rms on valid rows, mostly {largest}")]


def _score(result: LogRun, truth: TruthFit | None) -> list[Row]:
    """Return the error against the true position, if the log has one."""
    statistics, position = result.statistics, result.machine.position_output
    if not statistics.scored or (truth is not None and truth.wrong_turns):
        return []
    mean, factor = statistics.error / statistics.scored, position.factor

    def formatted(value: float) -> str:
        if position.unit == "°":
            return f"{factor * value:.2f}°"
        return f"{factor * value:.3g} {position.unit}".replace("  ", " ")

    return [
        (
            "  error",
            f"{formatted(statistics.rms_error)} rms, {formatted(statistics.error_max)} at most, "
            f"mean {formatted(mean)}, on {statistics.scored} valid rows with a true value",
        )
    ]


def _speed(result: LogRun) -> list[Row]:
    """Return the range of the speed."""
    if result.plain is None:
        return []
    columns = result.statistics.thin.columns()
    valid = columns["valid"] > 0
    if not valid.any():
        return []
    machine = result.rotor
    electrical = columns["speed_e"][valid]
    mechanical = columns["speed_mech"][valid] if "speed_mech" in columns else None
    if mechanical is None:
        mechanical = electrical / machine.n_p
    low, high = RPM * float(mechanical.min()), RPM * float(mechanical.max())
    e_low, e_high = float(electrical.min()), float(electrical.max())
    return [
        (
            "speed",
            f"{low:.0f} to {high:.0f} rpm on valid rows "
            f"({e_low:.4g} to {e_high:.4g} rad/s electrical)",
        )
    ]


def lag_effect(lag: float) -> str:
    """Say when a row's voltage acts."""
    if lag == 0:
        return "a voltage acts from its row on"
    amount = f"{abs(lag):g} sample{'' if abs(lag) == 1 else 's'}"
    return f"a voltage acts {amount} {'later' if lag < 0 else 'earlier'} than its row"


def _lag(result: LogRun) -> list[Row]:
    """Return the lag that was stated, learnt or assumed."""
    lag, decision = result.log.layout.lag, result.lag
    effect = lag_effect(lag)
    if decision is None:
        source = "stated" if result.log.layout.lag_stated else "assumed"
        return [("lag", f"{signed(lag)}, {source}: {effect}")]
    origin = "from the log"
    if result.log.true is not None and is_position(result.log, result.machine):
        origin = "from the log and its true angle"
    if decision.decided:
        weight = decision.weights[decision.lag]
        text = f"{signed(lag)}, learnt {origin} (probability {weight:.0%}): {effect}"
        if result.fractional_lag is not None:
            value, std = result.fractional_lag
            text += f"; as a fraction {value:+.2f} ± {std:.2f} samples"
        return [("lag", text)]
    degrees = np.degrees(decision.position_difference)
    difference = (
        f"; the positions with these lags differ by {degrees:.2g}° rms, weighted in σ"
        if np.isfinite(degrees)
        else ""
    )
    return [
        ("lag", f"not determined by the log: {decision.alternatives}{difference}. State the lag")
    ]


def _unknowns(result: LogRun) -> list[Row]:
    """Name the unknowns of a causal run."""
    if isinstance(result.observer, ImmersionObserver):
        unknowns = ", ".join(result.observer.immersion.unknowns)
        return [("unknowns", f"{unknowns}; memory {result.observer.memory:g} s")]
    if not result.automatic or result.adaptive is None or result.budget is not None:
        return []
    return [("unknowns", ", ".join(result.unknowns))]


def mean_of(result: LogRun, output: str) -> np.ndarray:
    """Return the mean of a vector output over the valid rows, (2,)."""
    ports = result.machine.ports
    return np.array([result.statistics.mean(f"{output}_{port}") for port in ports])


def _drift(result: LogRun) -> list[Row]:
    if not result.statistics.valid:
        return []
    drift, machine = mean_of(result, "drift"), result.machine
    if isinstance(machine, RotatingMachine):
        size = float(np.hypot(*drift))
        return [
            (
                "drift",
                f"{drift[0]:+.4g}, {drift[1]:+.4g} V in αβ: as from a voltage offset of "
                f"{si(size, 'V')}, or a current offset of {si(size / machine.R_s, 'A')}",
            )
        ]
    offset = -np.linalg.solve(machine.B, drift)
    return [
        (
            "drift",
            f"{drift[0]:+.4g}, {drift[1]:+.4g} V: as from voltage offsets of {offset[0]:+.3g}, "
            f"{offset[1]:+.3g} V",
        )
    ]


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


def _current_bias(result: LogRun) -> list[Row]:
    if "current-bias" not in result.unknowns or not result.statistics.valid:
        return []
    if not bias_is_seen(result):
        return [("current bias", "the log does not determine it")]
    bias, std = mean_of(result, "current_bias"), _bias_std(result)
    assumed = ", if the voltage has no offset" if result.unknowns == ("current-bias",) else ""
    return [
        (
            "current bias",
            f"{bias[0]:+.4g} ± {std[0]:.2g}, {bias[1]:+.4g} ± {std[1]:.2g} A{assumed}",
        )
    ]


def _flux(result: LogRun) -> list[Row]:
    if result.plain is None or not result.statistics.valid:
        return []
    if result.adaptive is not None and not result.rotor.flux_moves:
        return []
    return [(result.rotor.length_name.lower(), si(result.statistics.mean("psi_f"), "Wb"))]


def _quantity(value: float, std: float, unit: str) -> str:
    """Format a value with its standard deviation in a common unit."""
    size = max(abs(value), std)
    factor, prefix = next((entry for entry in PREFIXES if size >= entry[0]), PREFIXES[-1])
    digits = max(0, 1 - int(np.floor(np.log10(std / factor)))) if std > 0 else 3
    return f"{value / factor:.{digits}f} ± {std / factor:.{digits}f} {prefix}{unit}"


def _parameters(result: LogRun) -> list[Row]:
    """Return a row for each parameter that was learnt, with its value in the machine file."""
    adaptive, learnt = result.adaptive, result.learnt
    if adaptive is None or learnt is None or not result.statistics.valid:
        return []
    if not result.statistics.last_adapting:
        return [("parameters", "none learnt: the position was not valid for long enough")]
    machine = result.rotor
    names = {"magnet flux": "psi_f", "resistance": "R_s", "inverter": "inverter"}
    known = {
        "magnet flux": bool(machine.magnet_flux),
        "resistance": True,
        "inverter": machine.inverter_voltage is not None,
    }
    rows, unidentified = [], []
    for parameter in parameters(adaptive, learnt):
        name = names[parameter.name]
        if not parameter.told:
            unidentified.append(name)
            continue
        # A value at its limit of zero may differ from zero by rounding.
        value = parameter.value if abs(parameter.value) > 1e-6 * parameter.std else 0.0
        quantity = _quantity(value, parameter.std, parameter.unit)
        file = si(parameter.assumed, parameter.unit)
        rows.append((name, f"{quantity} ({'file' if known[parameter.name] else 'assumed'} {file})"))
    priors = (adaptive.L_d_std, adaptive.L_q_std)
    for n in range(2):
        std = learnt.inductance_std[n]
        if 0 < std <= UNSEEN * priors[n]:
            L, error = machine.L_dq[n], learnt.inductance_error[n]
            quantity = _quantity(L * (1 + error), L * std, "H")
            rows.append((machine.inductances[n], f"{quantity} (file {si(L, 'H')})"))
    if adaptive.asymmetry_std > 0 and max(learnt.asymmetry_std) <= UNSEEN * adaptive.asymmetry_std:
        size, std = np.hypot(*learnt.asymmetry), max(learnt.asymmetry_std)
        rows.append(("asymmetry", f"{100 * size:.2g} ± {100 * std:.1g} % between the phases"))
    if unidentified:
        rows.append(("not learnt", f"{', '.join(unidentified)}: the log does not determine it"))
    if len(learning_segments(result.log)) > 1 and rows:
        rows.append(("  from", "segments that are spread over the log"))
    return rows


def _truth_errors(result: LogRun, truth: TruthFit | None) -> list[Row]:
    """Describe the errors of the truth channel, and the position error without these errors."""
    if truth is None or not truth.told:
        return []
    columns = "" if result.log.true is None else " ".join(result.log.true.columns)
    label = {"hall": "Hall sensors"}.get(truth.channel, "encoder")
    text = f"{truth.channel} ({columns}): {'; '.join(truth.words)}"
    if not np.isfinite(truth.rms):
        return [(label, text)]
    if truth.channel.startswith("speed"):
        return [
            ("speed signal", text),
            ("  difference", f"{truth.rms:.3g} rad/s rms, {truth.most:.3g} at most"),
        ]
    remaining = f"{np.degrees(truth.rms):.2f}° rms, {np.degrees(truth.most):.2f}° at most"
    return [(label, text), ("  scatter" if truth.channel == "hall" else "  remaining", remaining)]


def _quality(result: LogRun) -> list[Row]:
    """Count the rows with marks that are no faults."""
    marked = result.statistics.quality.marked
    events = [
        f"{name} on {marked[name].rows} rows ("
        f"{times_of(marked[name].stretches, marked[name].count, NAMED_MARKS)})"
        for name in EVENTS
        if name in marked
    ]
    return [("marks", f"for information: {'; '.join(events)}")] if events else []


def _next(result: LogRun, checked: Check | None) -> list[Row]:
    """Say what to do next."""
    budget = result.budget
    advice = "" if budget is None or not budget.rows else budget.advice
    unseen = checked is not None and UNSEEN_TURN in checked.notes
    text = "without a true angle, the direction of rotation and n_p cannot be told"
    return [("next", row) for row in (advice, text if unseen else "") if row]
