"""What should make the reader of a run wary: causes and remedies, by observer."""

from __future__ import annotations

import numpy as np

from ..checking.findings import Check
from ..machines import RotatingMachine
from ..machines.model.flux_table import RECIPROCITY
from ..observers import LeastSquaresObserver
from .columns import is_position
from .learning import doubtful
from .run import LogRun
from .summary import bias_is_seen, si
from .truth import TruthFit

#: Warn below this many samples per electrical period: the cubic through four currents then misses a
#: percent of the resistive drop (benchmarks/accuracy.py).
SAMPLES_PER_PERIOD = 8
#: If the machine moves and fewer than this share of the rows are valid, something does not fit.
VALID_SHARE = 0.5
#: A summary means something only if the log lasts this many memories: after three, e⁻³ = 5 % of the
#: start is left. With unknown resistance or inverter, three pass before a position is valid.
MEMORIES, MEMORIES_ADAPTIVE = 3, 5
#: Mention a missing truth if fewer than this share of the valid rows have one.
TRUTH_SHARE = 0.99
#: A voltage below this many resistive drops means standstill, or nearly.
STANDING = 2.0


def warnings(result: LogRun, found: Check | None, fit: TruthFit | None = None) -> list[str]:
    """The warnings of a run whose log was checked, the most important first."""
    if result.plain is None:
        return [*_samples(result), *_jumps(result), *_immersed_validity(result), *_bias(result)]
    duration = result.statistics.rows * result.log.sample_time
    memories = MEMORIES if result.adaptive is None else MEMORIES_ADAPTIVE
    if duration < memories * result.observer.memory:
        return [
            *_samples(result),
            f"The log lasts {si(duration, 's')}, too short to settle: at least {memories} "
            f"memories of {si(result.observer.memory, 's')} are needed.",
        ]
    mistakes = [] if found is None else [str(finding) for finding in found.mistakes]
    return [
        *_samples(result),
        *mistakes,
        *_reciprocity(result),
        *_truth(result),
        *([] if fit is None or fit.lost is None else [f"Of {fit.channel}: {fit.lost}."]),
        *_rate(result),
        *_validity(result),
        *(
            []
            if result.adaptive is not None or mistakes
            else _residual(result, result.plain, found)
        ),
    ]


def _reciprocity(result: LogRun) -> list[str]:
    """A flux map that no machine without losses can have."""
    machine = result.machine
    fit = machine.saturation if isinstance(machine, RotatingMachine) else None
    if fit is None or fit.reciprocity <= RECIPROCITY:
        return []
    return [
        f"The machine's flux map is not reciprocal: the derivatives of psi_d by i_q and of psi_q "
        f"by i_d differ by {fit.reciprocity:.0%} of the mean inductance; up to {RECIPROCITY:.0%} "
        f"is usual. Do its fluxes and currents belong to one angle, and do their signs agree?"
    ]


def _samples(result: LogRun) -> list[str]:
    counts = result.counts
    bad = [
        f"{what}: {number}"
        for number, what in (
            (counts.bad_currents, "without a current (bridged)"),
            (counts.bad_voltages, "without a voltage (bridged)"),
            (counts.absurd, "with an impossible value"),
            (counts.outliers, "that contradict the others (ignored)"),
            (counts.outside, "with a current outside the machine's flux map (not valid)"),
        )
        if number
    ]
    if not bad:
        return []
    restarts = f"; the observer started anew {counts.restarts} ×" if counts.restarts else ""
    return [f"Number of rows {', '.join(bad)}{restarts}."]


def _truth(result: LogRun) -> list[str]:
    statistics = result.statistics
    if not is_position(result.log, result.machine):
        true, samples = result.log.true, statistics.truth
        if true is None or samples is None or samples.known or not statistics.valid:
            return []
        codes = " (the codes of Hall sensors are whole numbers)" if true.channel == "hall" else ""
        return [f"The truth, {' '.join(true.columns)}, has a value on no valid row{codes}."]
    if statistics.scored >= TRUTH_SHARE * statistics.valid:
        return []
    return [
        f"The true angle is known on only {statistics.scored} of {statistics.valid} valid rows."
    ]


def _rate(result: LogRun) -> list[str]:
    h, series = result.log.sample_time, result.statistics.thin.columns()
    speed = np.abs(series["speed_e"][series["valid"] > 0])
    if len(speed) == 0:
        # Without a position, the current vector's own rotation must do.
        speed = np.array([result.scales.current_speed])
    fastest = float(np.percentile(speed, 99))
    if fastest <= 0 or 2 * np.pi / (fastest * h) >= SAMPLES_PER_PERIOD:
        return []
    needed = SAMPLES_PER_PERIOD * fastest / (2 * np.pi)
    return [
        f"Only {2 * np.pi / (fastest * h):.1f} samples an electrical period at "
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
        "the voltage is hardly more than the resistive drop; at or near standstill the flux "
        "cannot be observed"
        if still
        else "check R_s and the inductances, the voltage columns and their scale, --frame and --lag"
    )
    share = statistics.valid / statistics.rows
    return [f"The position is valid on only {share:.1%} of the rows: {reason}."]


def _residual(result: LogRun, plain: LeastSquaresObserver, found: Check | None) -> list[str]:
    statistics, machine = result.statistics, result.rotor
    if not statistics.valid:
        return []
    # Without magnets λ - L i says little about the flux.
    flux = statistics.mean("psi_f") if machine.magnets else plain.flux_base
    rms = np.sqrt(statistics.innovation / statistics.settled)
    residual = float(rms * plain.constraint_noise / flux**2)
    if not doubtful(residual, machine, flux, result.scales):
        return []
    fits = "" if found is None else found.fits
    return [
        f"The residual of the machine's relation is more than noise explains, {residual:.1%} of "
        f"the flux squared, with R_s and inverter held as given."
        + (f" In stretches of the log {fits}." if fits else "")
        + " Find them with --unknowns auto, or with `fluxobs identify`."
    ]


def _jumps(result: LogRun) -> list[str]:
    restarts = result.counts.restarts
    if not restarts:
        return []
    return [
        f"Started anew {restarts} ×: samples contradicted all earlier ones. Something that should "
        f"be constant has jumped, or the assumed noise is too small."
    ]


def _immersed_validity(result: LogRun) -> list[str]:
    statistics = result.statistics
    if not statistics.valid:
        return [
            "The flux was never known: there is too little excitation for the noise, or machine "
            "data, column scale or --lag are wrong."
        ]
    if statistics.valid >= VALID_SHARE * statistics.rows:
        return []
    advice = (
        "--unknowns drift needs less."
        if "current-bias" in result.unknowns
        else "A longer --memory may see weaker excitation."
    )
    return [
        f"The flux is known on only {statistics.valid / statistics.rows:.1%} of the rows: there is "
        f"little excitation for the noise. {advice}"
    ]


def _bias(result: LogRun) -> list[str]:
    if "current-bias" not in result.unknowns or not result.statistics.valid or bias_is_seen(result):
        return []
    return [
        "This log hardly shows the current bias, and its wrong estimate disturbs the rest: "
        "--unknowns drift ignores it, which costs little."
    ]
