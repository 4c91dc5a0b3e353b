"""The warnings of a run: causes and remedies, by observer."""

from __future__ import annotations

import numpy as np

from ..checking.findings import Check
from ..estimation.budget import Budget
from ..estimation.columns import is_position
from ..estimation.course import CONVERGED_MISFIT
from ..estimation.learning import doubtful
from ..estimation.quality import times_of
from ..estimation.run import LogRun
from ..estimation.truth import TruthFit
from ..logs.quality.marks import MARKS
from ..machines import RotatingMachine
from ..machines.model.flux_table import RECIPROCITY
from ..observers import LeastSquaresObserver
from ..smoothing.assumptions import ITEMS
from ..smoothing.estimate import VALID_STD
from .summary import NAMED_MARKS, bias_is_seen, si

#: Warn if an electrical period has fewer samples than this. With fewer samples, the error of the
#: cubic through four currents exceeds a percent of the resistive drop (benchmarks/accuracy.py).
SAMPLES_PER_PERIOD = 8
#: If a smaller share of a moving machine's rows is valid, the machine data or the log is wrong.
VALID_SHARE = 0.5
#: A summary is meaningful if the log lasts this many memories: after three memories, e⁻³ = 5 % of
#: the initial error remains. With unknown resistance or inverter, no position is valid earlier.
MEMORIES, MEMORIES_ADAPTIVE = 3, 5
#: Number of stretches that a warning names.
NAMED_STRETCHES = 5
#: Marks of faults, and those that explain why a stretch does not fit.
FAULT_NAMES = tuple(mark.name for mark in MARKS if mark.fault)
EXPLAINING = ("missing", "repeated", "held", "clipped", "bridge off")
#: Warn of missing truth if a smaller share of the valid rows has a true value.
TRUTH_SHARE = 0.99
#: Warn of a wrong inductance from this probability on.
DOUBTED = 0.5
#: A voltage below this multiple of the resistive drop means standstill or very slow rotation.
STANDING = 2.0


def warnings(result: LogRun, checked: Check | None, fit: TruthFit | None = None) -> list[str]:
    """Return the warnings, the most important first; `checked` is the check of the run's log."""
    if result.plain is None:
        return [*_samples(result), *_jumps(result), *_immersed_validity(result), *_bias(result)]
    duration = result.statistics.rows * result.log.sample_time
    memories = MEMORIES if result.adaptive is None else MEMORIES_ADAPTIVE
    unknown = result.budget is None or not result.statistics.valid
    if unknown and duration < memories * result.observer.memory:
        return [
            *_samples(result),
            f"The log lasts {si(duration, 's')}, too short to settle: at least {memories} "
            f"memories of {si(result.observer.memory, 's')} are needed.",
        ]
    mistakes = [] if checked is None else [str(finding) for finding in checked.mistakes]
    return [
        *_samples(result),
        *mistakes,
        *_reciprocity(result),
        *_truth(result),
        *([] if fit is None or fit.lost is None else [f"Channel {fit.channel}: {fit.lost}."]),
        *_rate(result),
        *misfit_warnings(result),
        *_validity(result),
        *(
            []
            if result.adaptive is not None or result.budget is not None or mistakes
            else _residual(result, result.plain, checked)
        ),
    ]


def misfit_warnings(result: LogRun) -> list[str]:
    """Warn of a log that does not fit the model within what the budget allows."""
    budget = result.budget
    if budget is None:
        return []
    if budget.contradiction:
        item = next(item for item in ITEMS if item.name == budget.contradiction)
        inductances = dict(zip(("L_d", "L_q"), result.rotor.inductances, strict=True))
        name = inductances.get(item.name, f"the {item.name}")
        return [
            f"No row is valid: the log fits only with an error of {name} far beyond what is "
            f"assumed ({item.reason}). To mend it, {item.remedy}. Or check the columns with "
            f"their scales and signs, and --lag."
        ]
    if budget.wrong_inductance > DOUBTED:
        return [_inductance(result, budget), *_stretches(result, budget.stretches)]
    if budget.misfit > CONVERGED_MISFIT:
        return [
            "The log does not fit the machine: the innovations are larger than every usual error "
            "together explains, so few rows or none are valid. Check the machine file, the columns "
            "with their scales and signs, and --lag."
        ]
    return _stretches(result, budget.stretches)


def _inductance(result: LogRun, budget: Budget) -> str:
    """Name the inductance that fits if that of the machine file does not."""
    machine, learnt = result.rotor, result.learnt
    assert learnt is not None
    name, ratio = machine.inductance_names[0], 1 + learnt.inductance_error[0]
    value, std = ratio * machine.L_dq[0], learnt.inductance_std[0] * machine.L_dq[0]
    return (
        f"{name} in the machine file does not fit, with a probability of "
        f"{budget.wrong_inductance:.0%}: {si(value, 'H')} ± {si(std, 'H')} fits. The file may be "
        f"that of another machine, or the machine is salient (L_q alone would differ) or "
        f"saturates. The standard deviations contain this doubt. Measure L_q under load or run "
        f"`fluxobs identify`."
    )


def _stretches(result: LogRun, stretches: list[tuple[float, float]]) -> list[str]:
    """Name the stretches that contradict the record, unless their marks explain them."""
    explained = [
        stretch
        for name in EXPLAINING
        if name in result.statistics.quality.marked
        for stretch in result.statistics.quality.marked[name].stretches
    ]
    unknown = [
        (start, end)
        for start, end in stretches
        if not any(first <= end and start <= last for first, last in explained)
    ]
    if not unknown:
        return []
    return [
        f"These stretches contradict the record before and behind them, so they are not valid and "
        f"teach nothing: {times_of(unknown, len(unknown), NAMED_STRETCHES)}. Something happened "
        f"there that the columns do not show: a bridge that was off, a fast fault, a jump of a "
        f"parameter."
    ]


def _reciprocity(result: LogRun) -> list[str]:
    """Warn of a flux map that no lossless machine can have."""
    machine = result.machine
    fit = machine.saturation if isinstance(machine, RotatingMachine) else None
    if fit is None or fit.reciprocity <= RECIPROCITY:
        return []
    return [
        f"The machine's flux map is not reciprocal: ∂psi_d/∂i_q and ∂psi_q/∂i_d differ by "
        f"{fit.reciprocity:.0%} of the mean inductance; up to {RECIPROCITY:.0%} is usual. Check "
        f"that its fluxes and currents refer to the same rotor angle and that their signs agree."
    ]


def _samples(result: LogRun) -> list[str]:
    counts, marked = result.counts, result.statistics.quality.marked
    bad = [
        f"{entry.rows} {name} ({times_of(entry.stretches, entry.count, NAMED_MARKS)})"
        for name, entry in marked.items()
        if name in FAULT_NAMES
    ]
    if result.plain is None:
        bad = [
            f"{number} {fault}"
            for number, fault in (
                (counts.bad_currents, "without a current (bridged)"),
                (counts.bad_voltages, "without a voltage (bridged)"),
                (counts.absurd, "with an implausible value"),
                (counts.outliers, "that contradict the others (outliers, ignored)"),
            )
            if number
        ]
    if counts.outside:
        bad.append(f"{counts.outside} with a current outside the machine's flux map (not valid)")
    if not bad:
        return []
    restarts = f"; observer restarts: {counts.restarts}" if counts.restarts else ""
    return [f"Bad rows: {', '.join(bad)}{restarts}."]


def _truth(result: LogRun) -> list[str]:
    statistics = result.statistics
    if not is_position(result.log, result.machine):
        true, samples = result.log.true, statistics.truth
        if true is None or samples is None or samples.known or not statistics.valid:
            return []
        codes = " (Hall codes must be whole numbers)" if true.channel == "hall" else ""
        return [f"The truth channel {' '.join(true.columns)} has no value on any valid row{codes}."]
    if statistics.scored >= TRUTH_SHARE * statistics.valid:
        return []
    return [
        f"The true angle is known on only {statistics.scored} of {statistics.valid} valid rows."
    ]


def _rate(result: LogRun) -> list[str]:
    h, series = result.log.sample_time, result.statistics.thin.columns()
    speed = np.abs(series["speed_e"][series["valid"] > 0])
    if len(speed) == 0:
        marked = result.statistics.quality.marked.get("injected")
        if marked is not None and marked.rows > result.statistics.rows / 2:
            return []  # the current vector turns with the injected signal
        # Without a valid position, use the speed of the current vector.
        speed = np.array([result.scales.current_speed])
    fastest = float(np.percentile(speed, 99))
    if fastest <= 0 or 2 * np.pi / (fastest * h) >= SAMPLES_PER_PERIOD:
        return []
    needed = SAMPLES_PER_PERIOD * fastest / (2 * np.pi)
    return [
        f"Only {2 * np.pi / (fastest * h):.1f} samples per electrical period at "
        f"{fastest:.4g} rad/s: at least {SAMPLES_PER_PERIOD} are needed, a sample rate of "
        f"{np.ceil(needed):.0f} Hz or more."
    ]


def _validity(result: LogRun) -> list[str]:
    statistics, machine = result.statistics, result.rotor
    if statistics.valid >= VALID_SHARE * statistics.rows:
        return []
    still = result.scales.voltage < STANDING * machine.R_s * result.scales.current
    missing = result.counts.bad_currents
    if statistics.valid >= VALID_SHARE * (statistics.rows - missing):
        return [
            f"The position is valid on only {statistics.valid / statistics.rows:.1%} of the rows: "
            f"{missing} rows have no current."
        ]
    reason = (
        "the voltage hardly exceeds the resistive drop; at or near standstill the flux cannot "
        "be observed"
        if still
        else "check R_s and the inductances, the voltage columns and their scale, --frame and --lag"
    )
    budget, lag = result.budget, result.lag
    if lag is not None and not lag.decided and not lag.position_difference < VALID_STD / 2:
        degrees = np.degrees(lag.position_difference)
        reason = "the log does not determine the lag of the voltages: state --lag" + (
            f". The positions with the two most probable lags differ by {degrees:.2g}°"
            if np.isfinite(degrees)
            else ""
        )
    elif budget is not None and budget.misfit < CONVERGED_MISFIT and not still:
        reason = (
            f"on the others its standard deviation exceeds {np.degrees(VALID_STD):.0f}°, as near "
            "standstill"
        )
    if result.examined is not None and result.examined.rearranged:
        return ["No row is valid until that is corrected."]
    if budget is not None and (budget.contradiction or budget.wrong_inductance > DOUBTED):
        return []  # named already
    share = statistics.valid / statistics.rows
    return [f"The position is valid on only {share:.1%} of the rows: {reason}."]


def _residual(result: LogRun, plain: LeastSquaresObserver, checked: Check | None) -> list[str]:
    statistics, machine = result.statistics, result.rotor
    if not statistics.valid:
        return []
    # Without magnets, λ - L i is not a measure of the flux.
    flux = statistics.mean("psi_f") if machine.magnets else plain.flux_base
    rms = np.sqrt(statistics.innovation / statistics.settled)
    residual = float(rms * plain.constraint_noise / flux**2)
    if not doubtful(residual, machine, flux, result.scales):
        return []
    better_values = "" if checked is None else checked.fits
    return [
        f"The residual of the machine's relation is larger than noise explains: {residual:.1%} of "
        f"the flux squared, with your values of R_s and inverter."
        + (f" In segments of the log, {better_values}." if better_values else "")
        + " Estimate R_s and inverter with --unknowns auto, or run `fluxobs identify`."
    ]


def _jumps(result: LogRun) -> list[str]:
    restarts = result.counts.restarts
    if not restarts:
        return []
    return [
        f"Observer restarts: {restarts}, because samples contradicted all earlier ones. A quantity "
        f"that should be constant has jumped, or the assumed noise is too small."
    ]


def _immersed_validity(result: LogRun) -> list[str]:
    statistics = result.statistics
    if not statistics.valid:
        return [
            "The flux was never valid: the excitation is too weak for the noise, or the machine "
            "data, the scale of a column or --lag is wrong."
        ]
    if statistics.valid >= VALID_SHARE * statistics.rows:
        return []
    advice = (
        "--unknowns drift needs less excitation."
        if "current-bias" in result.unknowns
        else "With a longer --memory, weaker excitation may suffice."
    )
    return [
        f"The flux is valid on only {statistics.valid / statistics.rows:.1%} of the rows: the "
        f"excitation is too weak for the noise. {advice}"
    ]


def _bias(result: LogRun) -> list[str]:
    if "current-bias" not in result.unknowns or not result.statistics.valid or bias_is_seen(result):
        return []
    return [
        "This log hardly determines the current bias, and a wrong bias disturbs the other "
        "estimates: use --unknowns drift, which ignores the bias at little cost."
    ]
