"""What should make the reader of a run wary: causes and remedies, by observer."""

from __future__ import annotations

import numpy as np

from ..observers import LeastSquaresObserver
from .run import Run
from .summary import bias_is_seen, si
from .suspects import RESIDUAL_LIMIT, largest_suspect

#: Samples an electrical period below which a warning is due: the cubic through four currents then
#: misses a percent of the resistive drop (benchmarks/accuracy.py).
SAMPLES_PER_PERIOD = 8
#: Ratio of found to given magnet flux outside which the given one looks wrong: beyond what heat and
#: tolerances do, within √2 and √3 of the usual mistakes.
PSI_RANGE = (0.75, 1.33)
#: Share of valid rows below which, in a log that moves, something does not fit.
VALID_SHARE = 0.5
#: Memories that a log must last for its summary to mean anything: after three e⁻³ = 5 % of the
#: start is left; where resistance or inverter are unknown, three pass before a valid position.
MEMORIES, MEMORIES_ADAPTIVE = 3, 5
#: Rms position error [rad] beyond which the truth itself is in doubt: no valid estimate is so far
#: off.
TRUTH_LIMIT = 0.5
#: Share of the valid rows below which a truth that is missing is worth a word.
TRUTH_SHARE = 0.99
#: A parameter this many standard deviations of its prior off went as far as it was let, which is
#: three, less rounding.
FAR = 2.8
#: A voltage below so many resistive drops: at standstill, or nearly.
STANDING = 2.0
#: So many times what noise explains of the residual are no cause for doubt.
NOISE_FACTOR = 3.0
#: What finds a suspect.
REMEDY = dict.fromkeys(
    ("R_s", "the inverter"),
    " Find it with --unknowns drift,resistance,inverter, or with `fluxobs identify`.",
)


def warnings(result: Run) -> list[str]:
    """The warnings of a run, in the order of their weight."""
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
    return [
        *_samples(result),
        *_truth(result),
        *_rate(result),
        *_validity(result),
        *_magnet_flux(result),
        *([] if result.adaptive is not None else _residual(result, result.plain)),
        *_far(result),
    ]


def _samples(result: Run) -> list[str]:
    counts = result.counts
    bad = [
        f"{what}: {number}"
        for number, what in (
            (counts.bad_currents, "without a current (bridged)"),
            (counts.bad_voltages, "without a voltage (bridged)"),
            (counts.absurd, "with an impossible value"),
            (counts.outliers, "that contradict the others (passed over)"),
        )
        if number
    ]
    if not bad:
        return []
    restarts = f"; the observer started anew {counts.restarts} ×" if counts.restarts else ""
    return [f"Number of rows {', '.join(bad)}{restarts}."]


def _truth(result: Run) -> list[str]:
    statistics, out = result.statistics, []
    if result.log.truth is None or not statistics.valid:
        return []
    if statistics.scored < TRUTH_SHARE * statistics.valid:
        out.append(
            f"The true angle is known on {statistics.scored} of {statistics.valid} valid rows only."
        )
    if statistics.scored and statistics.rms_error > TRUTH_LIMIT:
        out.append(
            "The true angle is far off: is it in radians (--scale theta_mech=0.0174533 "
            "for degrees), electrical or mechanical, n_p right, counted in the direction of a-b-c, "
            "zero where d lies along α?"
        )
    return out


def _rate(result: Run) -> list[str]:
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


def _validity(result: Run) -> list[str]:
    statistics, machine = result.statistics, result.rotor
    if statistics.valid >= VALID_SHARE * statistics.rows:
        return []
    still = result.scales.voltage < STANDING * machine.R_s * result.scales.current
    reason = (
        "the voltage is hardly more than the resistive drop: at standstill, or nearly, the flux "
        "cannot be seen"
        if still
        else "check R_s and the inductances, the voltage columns and their scale, --frame and --lag"
    )
    share = statistics.valid / statistics.rows
    return [f"The position is valid on {share:.1%} of the rows only: {reason}."]


def _magnet_flux(result: Run) -> list[str]:
    given = result.rotor.magnet_flux
    if not given or not result.statistics.valid:
        return []
    found = result.statistics.mean("psi_f")
    if PSI_RANGE[0] < found / given < PSI_RANGE[1]:
        return []
    return [
        f"psi_f = {given:g} Wb in the machine file looks wrong: the record says "
        f"{si(found, 'Wb')}. The estimates do not depend on it."
    ]


def _far(result: Run) -> list[str]:
    """A parameter that went as far as it was let."""
    adaptive, found = result.adaptive, result.statistics.found
    if adaptive is None or not found:
        return []
    cases = (
        ("R_s", "resistance", adaptive.resistance, adaptive.resistance_std, "resistance"),
        (
            *("inverter_voltage", "inverter_voltage"),
            *(adaptive.inverter_voltage, adaptive.inverter_std, "inverter"),
        ),
    )
    return [
        f"{name} went to the limit of its prior: {found[column]:.3g}, where {given:.3g} ± "
        f"{std:.2g} was given. Correct the machine file, or allow more with --prior {prior}=…; if "
        f"neither helps, something else is wrong."
        for name, column, given, std, prior in cases
        if std > 0 and abs(found[column] - given) > FAR * std
    ]


def _residual(result: Run, plain: LeastSquaresObserver) -> list[str]:
    statistics, machine = result.statistics, result.rotor
    # Without magnets λ - L i says little of the flux.
    flux = statistics.mean("psi_f") if statistics.valid and machine.magnets else plain.flux_base
    residual = np.inf
    if statistics.valid:
        rms = np.sqrt(statistics.innovation / statistics.settled)
        residual = float(rms * plain.constraint_noise / flux**2)
    noise = machine.constraint_noise(flux, result.scales.current_noise) / flux**2
    if residual < max(RESIDUAL_LIMIT, NOISE_FACTOR * noise):
        return []
    suspect = largest_suspect(result.log, machine, result.scales, plain.flux_base)
    size = "" if np.isinf(residual) else f", {residual:.1%} of the flux squared"
    if suspect is None:
        if np.isinf(residual):
            return []
        return [
            f"The residual of the machine's constraint is more than noise explains{size}; no "
            f"single error that is tried by default accounts for it."
        ]
    return [
        f"The residual of the machine's constraint is more than noise explains{size}. Largest "
        f"suspect: {suspect.name}; {suspect.advice} ({suspect.remaining:.0%} of the residual left)."
        f"{REMEDY.get(suspect.name, '')}"
    ]


def _jumps(result: Run) -> list[str]:
    restarts = result.counts.restarts
    if not restarts:
        return []
    return [
        f"Started anew {restarts} ×: samples contradicted all before. Something that should be "
        f"constant has jumped, or the assumed noise is too small."
    ]


def _immersed_validity(result: Run) -> list[str]:
    statistics = result.statistics
    if not statistics.valid:
        return [
            "The flux was never known: too little excitation for the noise, or machine data, "
            "column scale or --lag are wrong."
        ]
    if statistics.valid >= VALID_SHARE * statistics.rows:
        return []
    advice = (
        "--unknowns drift asks for less."
        if "current-bias" in result.unknowns
        else "A longer --memory may see weaker excitation."
    )
    return [
        f"The flux is known on {statistics.valid / statistics.rows:.1%} of the rows only: little "
        f"excitation for the noise. {advice}"
    ]


def _bias(result: Run) -> list[str]:
    if "current-bias" not in result.unknowns or not result.statistics.valid or bias_is_seen(result):
        return []
    return [
        "The current bias was hardly seen by this log, and what is taken for it disturbs "
        "the rest: --unknowns drift ignores it, which costs little."
    ]
