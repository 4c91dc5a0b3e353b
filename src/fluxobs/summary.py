"""What a run found, in one readable paragraph, and what should make its reader wary."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .estimate import Result
from .records import lag_in_words
from .suspects import RESIDUAL_LIMIT, largest_suspect

#: Samples an electrical period below which a warning is due.
SAMPLES_PER_PERIOD = 8
#: Ratio of found to given magnet flux outside which the given one looks wrong.
PSI_RANGE = (0.75, 1.33)
#: Share of valid rows below which, in a log that moves, something does not fit.
VALID_SHARE = 0.5
#: Memories that a log must last for its summary to be worth anything.
MEMORIES = 3
#: The same where resistance or inverter are unknown.
MEMORIES_ADAPTIVE = 5
#: A standard deviation that is left at this share of the prior's: nothing was learnt.
UNSEEN = 0.5
#: What finds a suspect.
REMEDY = dict.fromkeys(
    ("R_s", "the inverter"),
    " Find it with --unknowns drift,resistance,inverter, or with `fluxobs identify`.",
)
#: Rms position error [rad] beyond which the truth itself is in doubt.
TRUTH_LIMIT = 0.5


@dataclass(frozen=True)
class Summary:
    """One paragraph, and one sentence a warning."""

    paragraph: str
    warnings: list[str]


def summarise(result: Result) -> Summary:
    """Summary of a run."""
    return Summary(_paragraph(result), _warnings(result))


def _degrees(radians: float) -> str:
    return f"{np.degrees(radians):.2f}°"


def _si(value: float, unit: str) -> str:
    """Three digits and an SI prefix."""
    for factor, prefix in ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n")):
        if abs(value) >= factor:
            return f"{value / factor:.3g} {prefix}{unit}"
    return f"0 {unit}" if value == 0 else f"{value:.2g} {unit}"


def _paragraph(result: Result) -> str:
    tally, machine, log = result.tally, result.machine, result.log
    duration = tally.rows * log.sample_time
    head = (
        f"{tally.rows} samples, {duration:.4g} s at {1 / log.sample_time:.6g} Hz; "
        f"{lag_in_words(log.layout.lag)}."
    )
    if tally.first_valid is None:
        return f"{head} The position was never known."
    share = tally.valid / tally.rows
    drift = tally.drift / tally.valid
    size = float(np.hypot(*drift))
    flux = "Magnet flux" if hasattr(machine, "psi_f") else "Active flux (L_d - L_q) i_d"
    if hasattr(machine, "L_q") and hasattr(machine, "psi_f"):
        flux = "Active flux psi_f + (L_d - L_q) i_d"
    sentences = [
        head,
        f"The position is valid on {share:.1%} of the rows, first "
        f"{_si(tally.first_valid - tally.start, 's')} after the start.",
        f"The flux integral would drift by ({drift[0]:+.4g}, {drift[1]:+.4g}) V in αβ: as much as "
        f"a voltage offset of {_si(size, 'V')}, or a current offset of "
        f"{_si(size / machine.R_s, 'A')} through R_s.",
    ]
    if result.adaptive is None:
        sentences.append(f"{flux}: {_si(tally.psi / tally.valid, 'Wb')}.")
    sentences += _found(result)
    if tally.scored:
        mean = tally.error / tally.scored
        rms = np.sqrt(tally.error_squared / tally.scored)
        sentences.append(
            f"Against the true angle, on {tally.scored} valid rows: position error "
            f"{_degrees(rms)} rms, "
            f"{_degrees(tally.error_max)} at most, mean {_degrees(mean)}."
        )
    return " ".join(sentences)


def _found(result: Result) -> list[str]:
    """What the adaptive observer holds at the end, each with what was believed of it."""
    adaptive, found = result.adaptive, result.tally.found
    if adaptive is None:
        return []
    if not found:
        return ["Nothing was found of the machine: the position was not known for long enough."]
    machine = result.machine
    magnet = "given" if getattr(machine, "psi_f", None) is not None else "guessed from the log"
    drops = "given" if machine.inverter_voltage is not None else "assumed"
    told, untold = [], []
    for name, key, believed, prior, unit, source in (
        ("magnet flux", "psi_f", adaptive.psi_f, adaptive.psi_f_std, "Wb", magnet),
        ("resistance", "resistance", adaptive.resistance, adaptive.resistance_std, "Ω", "given"),
        (
            "inverter",
            "inverter_voltage",
            adaptive.inverter_voltage,
            adaptive.inverter_std,
            "V",
            drops,
        ),
    ):
        std = found[f"{key}_std"]
        if prior > 0 and std > UNSEEN * prior:
            untold.append(name)
        elif prior > 0:
            value = f"{_si(found[key], unit)} ± {_si(std, unit)}"
            told.append(f"{name} {value} ({_si(believed, unit)} {source})")
    text = [f"At the end: {', '.join(told)}."] if told else []
    if untold:
        text.append(f"The log does not tell {' and '.join(untold)}.")
    return text


def _warnings(result: Result) -> list[str]:
    duration = result.tally.rows * result.log.sample_time
    memories = MEMORIES if result.adaptive is None else MEMORIES_ADAPTIVE
    if duration < memories * result.observer.memory:
        return [
            *_sample_warnings(result),
            f"The log lasts {_si(duration, 's')}, too short to settle: at least {memories} "
            f"memories of {_si(result.observer.memory, 's')} are needed.",
        ]
    return [
        *_sample_warnings(result),
        *_truth_warnings(result),
        *_rate_warnings(result),
        *_validity_warnings(result),
        *_flux_warnings(result),
        *([] if result.adaptive is not None else _residual_warnings(result)),
        *_far_warnings(result),
    ]


def _sample_warnings(result: Result) -> list[str]:
    counts, out = result.counts, []
    bad = [
        f"{what}: {number}"
        for number, what in (
            (counts.bad_currents, "without a current (predicted over)"),
            (counts.bad_voltages, "without a voltage (the last one held)"),
            (counts.absurd, "with an impossible value"),
            (counts.outliers, "that contradict the others (passed over)"),
        )
        if number
    ]
    if bad:
        restarts = f"; the observer started anew {counts.restarts} ×" if counts.restarts else ""
        out.append(f"Number of rows {', '.join(bad)}{restarts}.")
    return out


def _truth_warnings(result: Result) -> list[str]:
    tally = result.tally
    out: list[str] = []
    if result.log.truth is None or not tally.valid:
        return out
    if tally.scored < 0.99 * tally.valid:
        out.append(f"The true angle is known on {tally.scored} of {tally.valid} valid rows only.")
    if tally.scored and np.sqrt(tally.error_squared / tally.scored) > TRUTH_LIMIT:
        out.append(
            "The true angle is far off: is it in radians (--scale theta_mech=0.0174533 "
            "for degrees), electrical or mechanical, n_p right, counted in the direction of a-b-c, "
            "zero where d lies along α?"
        )
    return out


def _rate_warnings(result: Result) -> list[str]:
    tally, h = result.tally, result.log.sample_time
    series = tally.thin.columns()
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


def _validity_warnings(result: Result) -> list[str]:
    tally = result.tally
    if tally.valid >= VALID_SHARE * tally.rows:
        return []
    still = result.scales.voltage < 2 * result.machine.R_s * result.scales.current
    reason = (
        "the voltage is hardly more than the resistive drop: at standstill, or nearly, the flux "
        "cannot be seen"
        if still
        else "check R_s and the inductances, the voltage columns and their scale, --frame and --lag"
    )
    return [f"The position is valid on {tally.valid / tally.rows:.1%} of the rows only: {reason}."]


def _flux_warnings(result: Result) -> list[str]:
    given = getattr(result.machine, "psi_f", None)
    if given is None or not result.tally.valid:
        return []
    found = result.tally.psi / result.tally.valid
    if PSI_RANGE[0] < found / given < PSI_RANGE[1]:
        return []
    return [
        f"psi_f = {given:g} Wb in the machine file looks wrong: the record says "
        f"{_si(found, 'Wb')}. The estimates do not depend on it."
    ]


def _far_warnings(result: Result) -> list[str]:
    """A parameter that went as far as it was let, three standard deviations of its prior."""
    adaptive, found = result.adaptive, result.tally.found
    if adaptive is None or not found:
        return []
    cases = (
        ("R_s", found["resistance"], adaptive.resistance, adaptive.resistance_std, "resistance"),
        (
            "inverter_voltage",
            found["inverter_voltage"],
            adaptive.inverter_voltage,
            adaptive.inverter_std,
            "inverter",
        ),
    )
    return [
        f"{name} went as far off the machine file as was believed possible, to {value:.3g} where "
        f"{given:.3g} ± {std:.2g} was given: correct the file, or allow more with --prior "
        f"{prior}=…; if neither helps, something else is wrong."
        for name, value, given, std, prior in cases
        if std > 0 and abs(value - given) > 2.8 * std
    ]


def _residual_warnings(result: Result) -> list[str]:
    tally, machine = result.tally, result.machine
    magnets = hasattr(machine, "psi_f")  # else λ - L i says little of the flux
    flux = tally.psi / tally.valid if tally.valid and magnets else result.observer.flux_base
    residual = np.inf
    if tally.valid:
        rms = np.sqrt(tally.innovation / tally.settled)
        residual = float(rms * result.observer.constraint_noise / flux**2)
    rated = machine.rated_current or result.scales.current
    noise = machine.constraint_noise(flux, rated, result.scales.current_noise) / flux**2
    if residual < max(RESIDUAL_LIMIT, 3 * noise):
        return []
    suspect = largest_suspect(result.log, machine, result.scales, result.observer.flux_base)
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
