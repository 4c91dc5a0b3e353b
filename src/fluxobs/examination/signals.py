"""What the signals themselves say: sampling, clipping, resolution, offsets at rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array
from ..logs.log import Log
from ..machines import RotatingMachine
from ..machines.model.frames import CURRENTS, PHASE_CURRENTS
from .item import Item, look_if

#: Rows that are looked at.
ROWS = 1_000_000
#: A converter at its end stays there: so many equal rows in a row are clipped.
CLIPPED = 4
#: Voltages and currents at rest, as shares of the log's 95th percentiles, for so many rows.
REST_VOLTAGE, REST_CURRENT, REST_ROWS = 0.01, 0.05, 100
#: Offsets of this share of the rated current, and gains that differ by this share, are usual.
OFFSET, GAIN = 0.01, 0.01
#: A step of the converter of this share of the rated current is coarse.
COARSE = 0.01
#: At least so many samples an electrical period.
SAMPLES = 8.0


def channels_of(log: Log) -> dict[str, Array]:
    """The channels of the first million rows."""
    parts = list(log.channels(log.first, min(log.last, log.first + ROWS)))
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def sampling(log: Log, speed: float) -> list[Item]:
    """Time stamps, gaps, and the rate against the fastest rotation [rad/s]."""
    clock = log.clock
    out = []
    if clock.missing:
        share = clock.missing / clock.rows
        words = f"{len(clock.at) - 1} gaps; the logger loses samples"
        verdict = look_if(share > 1e-4)
        out.append(Item("missing samples", verdict, words, float(clock.missing), None, "rows"))
    else:
        out.append(Item("missing samples", "fine", "", 0.0, None, "rows"))
    if clock.jitter:
        share = 100 * clock.jitter / clock.sample_time
        words = "of the sample time, rms; a hardware timer has less than 1 %"
        out.append(Item("jitter of the stamps", "look at it", words, share, None, "%"))
    if speed > 0:
        samples = float(2 * np.pi / (speed * clock.sample_time))
        few = samples < SAMPLES
        words = "at the highest speed" + (f"; at least {SAMPLES:g} are needed" if few else "")
        out.append(Item("samples a period", look_if(few), words, samples, None, ""))
    return out


def converters(channels: dict[str, Array], log: Log, rated: float) -> list[Item]:
    """Clipping and resolution of the measured currents."""
    out = []
    clipped, steps = [], []
    for name in CURRENTS[log.current_frame]:
        if name not in channels:
            continue
        values = channels[name][np.isfinite(channels[name])]
        if len(values) < 10:
            continue
        if (count := _clipped(values)) > 0:
            clipped.append(f"{name}: {count} rows")
        steps.append(_resolution(values))
    if clipped:
        words = "the current stays at its largest value: the converter or amplifier is at its end"
        out.append(Item("clipping", "look at it", f"{words} ({', '.join(clipped)})"))
    else:
        out.append(Item("clipping", "fine"))
    step = max(steps, default=0.0)
    if step > 0:
        verdict = look_if(step > COARSE * rated)
        words = f"{step / rated:.2%} of the rated current"
        out.append(Item("resolution of the currents", verdict, words, step, None, "A"))
    return out


def _clipped(values: Array) -> int:
    """Rows in runs of equal extreme values."""
    total = 0
    for extreme in (values.max(), values.min()):
        at = np.flatnonzero(values == extreme)
        if len(at) < CLIPPED:
            continue
        runs = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1)
        total += sum(len(run) for run in runs if len(run) >= CLIPPED)
    return total


def _resolution(values: Array) -> float:
    """The step between values, if they are of a converter."""
    levels = np.unique(values[:20_000])
    if len(levels) < 3 or len(levels) > min(len(values), 20_000) / 4:
        return 0.0
    return float(np.median(np.diff(levels)))


def offsets(channels: dict[str, Array], log: Log, rated: float) -> list[Item]:
    """Offsets of the current sensors, where the drive rests, or from the sum of three phases."""
    names = [name for name in CURRENTS[log.current_frame] if name in channels]
    if log.current_frame == "dq":
        return [_no_rest("currents are in rotor coordinates; log phase currents")]
    current = np.stack([channels[name] for name in names])
    rest = _at_rest(channels, log, current)
    out = []
    if rest.sum() >= REST_ROWS:
        for name, values in zip(names, current, strict=True):
            part = values[rest]
            part = part[np.isfinite(part)]
            std = float(part.std() / np.sqrt(len(part) / 10))
            mean = float(part.mean())
            verdict = look_if(abs(mean) - 2 * std > OFFSET * rated)
            words = f"{mean / rated:+.2%} of the rated current, in {len(part)} rows at rest"
            out.append(Item(f"offset of {name}", verdict, words, mean, std, "A"))
    else:
        out.append(_no_rest("log half a second with the bridge off, or at zero voltage"))
    if len(names) == 3 and tuple(names) == PHASE_CURRENTS:
        out += _sum(current, rated)
    return out


def _no_rest(test: str) -> Item:
    words = f"currents and voltages are never zero together in this log: {test}"
    return Item("offsets of the current sensors", "cannot be told", words)


def _at_rest(channels: dict[str, Array], log: Log, current: Array) -> NDArray[np.bool_]:
    voltage = [v for n, v in channels.items() if n.startswith(("u_", "d_"))]
    if not voltage:
        return np.zeros(current.shape[1], bool)
    u = np.stack(voltage)
    if log.frame == "duty":
        u = u - u.mean(axis=0)
    quiet = np.abs(u).max(axis=0) <= REST_VOLTAGE * float(np.nanpercentile(np.abs(u), 99))
    small = np.abs(current).max(axis=0) <= REST_CURRENT * float(
        np.nanpercentile(np.abs(current), 99)
    )
    rest = quiet & small
    # only runs that are long enough
    edges = np.flatnonzero(np.diff(np.concatenate([[0], rest.astype(int), [0]])))
    for start, stop in edges.reshape(-1, 2):
        if stop - start < REST_ROWS // 2:
            rest[start:stop] = False
    return np.asarray(rest, bool)


def _sum(current: Array, rated: float) -> list[Item]:
    """Three phase currents add up to nothing but their offsets; what follows them is a gain.

    With gains g the sum is (1 - g_c/g_a) i_a + (1 - g_c/g_b) i_b of the measured currents.
    """
    known = current[:, np.isfinite(current).all(axis=0)]
    if known.shape[1] < 100:
        return []
    total = known.sum(axis=0)
    # two of the phases: the third is less these
    A = np.stack([known[0], known[1], np.ones(known.shape[1])], axis=1)
    solved = np.linalg.lstsq(A, total, rcond=None)[0]
    left = total - A @ solved
    spread = np.sqrt(np.diag(np.linalg.pinv(A.T @ A))) * left.std() * 3.0
    out = []
    mean, std = float(solved[2]), float(spread[2])
    verdict = look_if(abs(mean) - 2 * std > 2 * OFFSET * rated)
    out.append(Item("sum of the three offsets", verdict, "", mean, std, "A"))
    for k, name in enumerate(("i_a", "i_b")):
        ratio = 1 / (1 - float(solved[k]))
        gain, error = 100 * (ratio - 1), 100 * float(spread[k]) * ratio**2
        if ratio < 0:
            words = f"it or i_c has the opposite sign: --scale {name}=-1, if i_c is right"
            out.append(Item(f"gain of {name}", "look at it", words))
            continue
        verdict = look_if(abs(gain) - 2 * error > 100 * GAIN)
        words = "larger than that of i_c"
        out.append(Item(f"gain of {name}", verdict, words, gain, error, "%"))
    return out


def rated_current(machine: RotatingMachine, channels: dict[str, Array]) -> float:
    """The rated current [A], or the largest one of the log."""
    if machine.rated_current:
        return machine.rated_current
    currents = [values for name, values in channels.items() if name.startswith("i_")]
    return float(np.nanmax(np.abs(np.concatenate(currents)))) or 1.0
