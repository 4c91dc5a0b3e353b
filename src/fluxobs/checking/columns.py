"""Mistakes that the columns of a log reveal without a machine."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from ..core.arrays import Array
from ..logs.log import Log
from ..logs.meaning.guess import DUTY_MOST, TURNS, turn_of
from ..logs.quality.detect import IDLE_SHARE
from ..logs.quality.floating import floating_phase
from ..machines.model.frames import CURRENTS, PHASE_CURRENTS, alphabeta_current
from .findings import Finding
from .segments import without_spikes

#: Number of rows to check, from the middle of the log.
ROWS = 20_000
#: Two columns hold the same signal if they differ by less than this share of their largest value.
SAME = 1e-9
#: Phase currents do not belong together if the rms of their sum exceeds this share of their rms.
SUM = 0.3
#: Integers are raw counts if their mean exceeds this many standard deviations.
RAW_OFFSET = 3.0
#: Report spikes if there are at least this many; fewer spikes may be real events.
SPIKES = 3


def check_columns(log: Log) -> list[Finding]:
    """Return the findings on the columns of a log: none if all columns look right."""
    first = max(log.first, (log.first + log.last - ROWS) // 2)
    batches = list(log.channels(first, min(first + ROWS, log.last)))
    channels = {name: np.concatenate([batch[name] for batch in batches]) for name in batches[0]}
    signals = {
        name: values
        for name, values in channels.items()
        if name not in ("t", "udc", "theta_e", "truth")
    }
    return [
        *_find_duplicates(signals, log),
        *_find_constants(signals, log),
        *_check_sum(signals),
        *_check_duties(signals),
        *_find_counts(signals),
        *_check_angles(channels, log),
        *_find_spikes(signals, log),
    ]


def _describe(channel: str, log: Log) -> str:
    column = log.names.get(channel, channel)
    return channel if column == channel else f"{channel} (column {column})"


def _find_duplicates(signals: dict[str, Array], log: Log) -> list[Finding]:
    raw = {
        name: (values - log.conversions[name][1]) / log.conversions[name][0]
        for name, values in signals.items()
    }
    findings = []
    for first, second in combinations(raw, 2):
        a, b = raw[first], raw[second]
        finite = np.isfinite(a) & np.isfinite(b)
        size = float(np.abs(a[finite]).max(initial=0.0))
        if size > 0 and float(np.abs(a[finite] - b[finite]).max()) < SAME * size:
            findings.append(
                Finding(
                    "columns",
                    f"{_describe(first, log)} and {_describe(second, log)} hold the same signal: "
                    f"give each channel its own column",
                    False,
                )
            )
    return findings


def _find_constants(signals: dict[str, Array], log: Log) -> list[Finding]:
    return [
        Finding("columns", f"{_describe(name, log)} never changes: is it the right column?", False)
        for name, values in signals.items()
        if np.isfinite(values).any() and np.nanmax(values) == np.nanmin(values)
    ]


def _check_sum(signals: dict[str, Array]) -> list[Finding]:
    if not set(PHASE_CURRENTS) <= set(signals):
        return []
    phases = np.stack([_remove_spikes(signals[name]) for name in PHASE_CURRENTS])
    phases = phases[:, np.isfinite(phases).all(axis=0)]
    phases = phases - phases.mean(axis=1, keepdims=True)

    def relative_sum(phases: Array) -> float:
        power = np.mean(phases.sum(axis=0) ** 2) / (np.mean(phases**2) + 1e-300)
        return float(np.sqrt(power))

    share = relative_sum(phases)
    if share < SUM:
        return []
    for n, name in enumerate(PHASE_CURRENTS):
        if relative_sum(phases * np.where(np.arange(3) == n, -1.0, 1.0)[:, None]) < SUM:
            message = (
                f"{name} has the opposite sign (--scale {name}=-1): with the sign reversed, the "
                f"sum is zero"
            )
            return [Finding("columns", message, False)]
    return [
        Finding(
            "columns",
            f"i_a + i_b + i_c is not zero but {share:.0%} of a phase current: does one of these "
            f"currents have the wrong column or the wrong sign?",
            False,
        )
    ]


def _remove_spikes(values: Array) -> Array:
    return np.asarray(without_spikes(values.astype(complex))[0].real)


def _check_duties(signals: dict[str, Array]) -> list[Finding]:
    duties = [np.abs(values) for name, values in signals.items() if name.startswith("d_")]
    largest = float(np.nanmax(np.concatenate(duties))) if duties else 0.0
    if largest <= DUTY_MOST:
        return []
    scales = (100.0, 1000.0, *(2.0**k for k in range(8, 17)))
    full = min((scale for scale in scales if largest <= scale), default=largest)
    return [
        Finding(
            "columns",
            f"a duty reaches {largest:g}, but duties must be shares of the DC link (0 to 1): are "
            f"the values counts or percent? If the full scale is {full:g}, give "
            + " ".join(f"--scale d_{phase}={1 / full:.6g}" for phase in "abc"),
            False,
        )
    ]


def _find_counts(signals: dict[str, Array]) -> list[Finding]:
    raw = []
    for name, values in signals.items():
        finite = values[np.isfinite(values)]
        is_whole = len(finite) > 0 and bool((finite == np.round(finite)).all())
        if is_whole and abs(finite.mean()) > RAW_OFFSET * finite.std() > 0:
            raw.append((name, float(finite.mean())))
    if not raw:
        return []
    zero = ", ".join(f"{name} about {mean:.0f}" for name, mean in raw)
    return [
        Finding(
            "columns",
            f"the values are whole numbers with a large mean ({zero}): are they raw converter "
            f"counts? Then give --adc CHANNEL=BITS,RANGE,ZERO, for example i=12,100,2048 for 12 "
            f"bits that span 100 A",
            False,
        )
    ]


def _check_angles(channels: dict[str, Array], log: Log) -> list[Finding]:
    findings = []
    truth = "" if log.true is None else log.true.channel
    for key, name in (("theta_e", "theta_e"), ("truth", truth)):
        if key not in channels or not name.startswith("theta"):
            continue
        unit = turn_of(channels[key])
        if unit is not None:
            turn = next(turn for turn, turn_unit in TURNS.items() if turn_unit == unit)
            findings.append(
                Finding(
                    "angle",
                    f"{name} wraps at {turn:g}: it is probably not in radians (--unit "
                    f"{name}={unit})",
                    False,
                )
            )
    return findings


def _blocks(signals: dict[str, Array], log: Log) -> bool:
    """Whether the phases float in turn: then the voltages are short at each commutation."""
    names = CURRENTS[log.current_frame]
    needed = 2 if names == PHASE_CURRENTS else len(names)
    if log.current_frame == "dq" or sum(name in signals for name in names) < needed:
        return False
    current = alphabeta_current(log.current_frame, signals)
    limit = IDLE_SHARE * float(np.nan_to_num(np.hypot(*current.T)).max(initial=0.0))
    return bool(floating_phase(current, None, limit).any())


def _find_spikes(signals: dict[str, Array], log: Log) -> list[Finding]:
    spiked = []
    stepping = ("d_", "u_") if _blocks(signals, log) else ("d_",)
    currents = [values for name, values in signals.items() if name.startswith("i_")]
    # A sample that was lost may be empty in one column and 0 in another.
    lost = np.isnan(np.stack(currents)).any(axis=0) if currents else False
    for name, values in signals.items():
        if name.startswith(stepping):
            continue
        if name.startswith("i_"):
            values = np.where(lost, np.nan, values)
        _, spikes = without_spikes(values.astype(complex))
        if spikes >= SPIKES:
            spiked.append((name, spikes))
    if not spiked:
        return []
    count = len(next(iter(signals.values())))
    where = ", ".join(f"{name}: {spikes}" for name, spikes in spiked)
    return [
        Finding(
            "spikes",
            f"single rows are far from their neighbours ({where}, in {count} rows): the observer "
            f"ignores these outliers, but their cause should be removed",
            False,
        )
    ]
