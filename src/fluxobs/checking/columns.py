"""Mistakes that show in the columns themselves, without a machine."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from ..core.arrays import Array
from ..logs.guess import DUTY_MOST, TURNS, turn_of
from ..logs.log import Log
from ..machines.model.frames import PHASE_CURRENTS
from .findings import Finding
from .segments import without_spikes

#: Rows that are looked at, from the middle of the log.
ROWS = 20_000
#: Columns that differ by less than this share of their size are the same column.
SAME = 1e-9
#: Phase currents whose sum is more than this share of them do not belong together.
SUM = 0.3
#: Whole numbers whose mean is more than so many times their standard deviation are raw counts.
RAW_OFFSET = 3.0
#: Fewer spikes than this are events.
SPIKES = 3


def columns(log: Log) -> list[Finding]:
    """Findings on the columns of a log; none if there is nothing to say."""
    first = max(log.first, (log.first + log.last - ROWS) // 2)
    parts = list(log.channels(first, min(first + ROWS, log.last)))
    channels = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    signals = {
        name: values
        for name, values in channels.items()
        if name not in ("t", "udc", "theta_e", "truth")
    }
    return [
        *_repeated(signals, log),
        *_constant(signals, log),
        *_sum(signals),
        *_duty(signals),
        *_counts(signals),
        *_angle(channels, log),
        *_spikes(signals),
    ]


def _name(channel: str, log: Log) -> str:
    column = log.names.get(channel, channel)
    return channel if column == channel else f"{channel} (column {column})"


def _repeated(signals: dict[str, Array], log: Log) -> list[Finding]:
    raw = {
        name: (values - log.conversions[name][1]) / log.conversions[name][0]
        for name, values in signals.items()
    }
    out = []
    for one, other in combinations(raw, 2):
        a, b = raw[one], raw[other]
        good = np.isfinite(a) & np.isfinite(b)
        size = float(np.abs(a[good]).max(initial=0.0))
        if size > 0 and float(np.abs(a[good] - b[good]).max()) < SAME * size:
            out.append(
                Finding(
                    "columns",
                    f"{_name(one, log)} and {_name(other, log)} hold the same signal: give each "
                    f"channel its own column",
                    False,
                )
            )
    return out


def _constant(signals: dict[str, Array], log: Log) -> list[Finding]:
    return [
        Finding("columns", f"{_name(name, log)} never changes: is it the right column?", False)
        for name, values in signals.items()
        if np.isfinite(values).any() and np.nanmax(values) == np.nanmin(values)
    ]


def _sum(signals: dict[str, Array]) -> list[Finding]:
    if not set(PHASE_CURRENTS) <= set(signals):
        return []
    phases = np.stack([_smooth(signals[name]) for name in PHASE_CURRENTS])
    phases = phases[:, np.isfinite(phases).all(axis=0)]
    phases = phases - phases.mean(axis=1, keepdims=True)

    def sum_of(phases: Array) -> float:
        power = np.mean(phases.sum(axis=0) ** 2) / (np.mean(phases**2) + 1e-300)
        return float(np.sqrt(power))

    share = sum_of(phases)
    if share < SUM:
        return []
    for n, name in enumerate(PHASE_CURRENTS):
        if sum_of(phases * np.where(np.arange(3) == n, -1.0, 1.0)[:, None]) < SUM:
            words = f"{name} has the opposite sign (--scale {name}=-1): the sum is zero with that"
            return [Finding("columns", words, False)]
    return [
        Finding(
            "columns",
            f"i_a + i_b + i_c is not zero but {share:.0%} of a phase current: is one of them "
            f"another column, or of the opposite sign?",
            False,
        )
    ]


def _smooth(values: Array) -> Array:
    return np.asarray(without_spikes(values.astype(complex))[0].real)


def _duty(signals: dict[str, Array]) -> list[Finding]:
    duties = [np.abs(values) for name, values in signals.items() if name.startswith("d_")]
    most = float(np.nanmax(np.concatenate(duties))) if duties else 0.0
    if most <= DUTY_MOST:
        return []
    scales = (100.0, 1000.0, *(2.0**k for k in range(8, 17)))
    full = min((scale for scale in scales if most <= scale), default=most)
    return [
        Finding(
            "columns",
            f"a duty reaches {most:g}, but is a share of the DC link, 0 to 1: are these counts, "
            f"or percent? If the full scale is {full:g}: "
            + " ".join(f"--scale d_{phase}={1 / full:.6g}" for phase in "abc"),
            False,
        )
    ]


def _counts(signals: dict[str, Array]) -> list[Finding]:
    raw = []
    for name, values in signals.items():
        known = values[np.isfinite(values)]
        whole = len(known) > 0 and bool((known == np.round(known)).all())
        if whole and abs(known.mean()) > RAW_OFFSET * known.std() > 0:
            raw.append((name, float(known.mean())))
    if not raw:
        return []
    zero = ", ".join(f"{name} about {mean:.0f}" for name, mean in raw)
    return [
        Finding(
            "columns",
            f"whole numbers about a large mean ({zero}): raw converter counts? Give --adc "
            f"CHANNEL=BITS,RANGE,ZERO, as i=12,100,2048 for 12 bits that span 100 A",
            False,
        )
    ]


def _angle(channels: dict[str, Array], log: Log) -> list[Finding]:
    out = []
    truth = "" if log.true is None else log.true.channel
    for key, name in (("theta_e", "theta_e"), ("truth", truth)):
        if key not in channels or not name.startswith("theta"):
            continue
        unit = turn_of(channels[key])
        if unit is not None:
            turn = next(turn for turn, one in TURNS.items() if one == unit)
            out.append(
                Finding(
                    "angle",
                    f"{name} wraps at {turn:g}: it seems not to be in radians (--unit "
                    f"{name}={unit})",
                    False,
                )
            )
    return out


def _spikes(signals: dict[str, Array]) -> list[Finding]:
    out = []
    for name, values in signals.items():
        if name.startswith("d_"):
            continue
        _, found = without_spikes(values.astype(complex))
        if found >= SPIKES:
            out.append((name, found))
    if not out:
        return []
    count = len(next(iter(signals.values())))
    where = ", ".join(f"{name}: {found}" for name, found in out)
    return [
        Finding(
            "spikes",
            f"single rows that leave their neighbours by far ({where}, in {count} rows): "
            f"an observer ignores what contradicts the machine, but mend the cause",
            False,
        )
    ]
