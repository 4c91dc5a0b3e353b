"""Items on the signals: sampling, clipping, resolution, offsets at rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array
from ..logs.log import Log
from ..machines import RotatingMachine
from ..machines.model.frames import CURRENTS, PHASE_CURRENTS
from .item import Item, flag_if

#: Largest number of rows to examine.
ROWS = 1_000_000
#: This many consecutive equal extreme values mean that the converter is at its limit.
CLIPPED = 4
#: At rest, voltages and currents are below these shares of their 99th percentiles. Periods of rest
#: last at least REST_ROWS / 2 consecutive rows each, and REST_ROWS rows in total.
REST_VOLTAGE, REST_CURRENT, REST_ROWS = 0.01, 0.05, 100
#: Largest normal offset, divided by the rated current; largest normal difference of gains.
OFFSET, GAIN = 0.01, 0.01
#: A resolution above this share of the rated current is coarse.
COARSE = 0.01
#: Smallest sufficient number of samples per electrical period.
SAMPLES = 8.0


def read_channels(log: Log) -> dict[str, Array]:
    """Return the channels of the first ROWS rows."""
    batches = list(log.channels(log.first, min(log.last, log.first + ROWS)))
    return {name: np.concatenate([batch[name] for batch in batches]) for name in batches[0]}


def check_sampling(log: Log, channels: dict[str, Array], speed: float) -> list[Item]:
    """Return items on gaps, jitter, and the sample rate at the highest speed [rad/s]."""
    clock = log.clock
    items = []
    read = next(iter(channels.values()))
    unknown = int(np.any([np.isnan(values) for values in channels.values()], axis=0).sum())
    empty = max(0, unknown - clock.missing)  # rows that gaps in time stand for are unknown too
    if clock.missing or empty:
        share = clock.missing / clock.rows + empty / len(read)
        parts = [f"{len(clock.at) - 1} gaps in time"] if clock.missing else []
        parts += [f"{empty} rows have an empty value"] if empty else []
        words = f"{' and '.join(parts)}; the logger loses samples"
        verdict = flag_if(share > 1e-4)
        items.append(
            Item("missing samples", verdict, words, float(clock.missing + empty), None, "rows")
        )
    else:
        items.append(Item("missing samples", "fine", "", 0.0, None, "rows"))
    if clock.jitter:
        share = 100 * clock.jitter / clock.sample_time
        words = "of the sample time, rms; a hardware timer has less than 1 %"
        items.append(Item("jitter of the stamps", "look at it", words, share, None, "%"))
    if speed > 0:
        samples = float(2 * np.pi / (speed * clock.sample_time))
        too_few = samples < SAMPLES
        words = "at the highest speed" + (f"; at least {SAMPLES:g} are needed" if too_few else "")
        items.append(Item("samples a period", flag_if(too_few), words, samples, None, ""))
    return items


def check_converters(channels: dict[str, Array], log: Log, rated: float) -> list[Item]:
    """Return items on clipping and resolution of the measured currents."""
    items = []
    clipped, steps = [], []
    for name in CURRENTS[log.current_frame]:
        if name not in channels:
            continue
        values = channels[name][np.isfinite(channels[name])]
        if len(values) < 10:
            continue
        if (count := _count_clipped(values)) > 0:
            clipped.append(f"{name}: {count} rows")
        steps.append(_resolution(values))
    if clipped:
        words = "the current stays at its extreme value: the converter or amplifier is at its limit"
        items.append(Item("clipping", "look at it", f"{words} ({', '.join(clipped)})"))
    else:
        items.append(Item("clipping", "fine"))
    step = max(steps, default=0.0)
    if step > 0:
        verdict = flag_if(step > COARSE * rated)
        words = f"{step / rated:.2%} of the rated current"
        items.append(Item("resolution of the currents", verdict, words, step, None, "A"))
    return items


def _count_clipped(values: Array) -> int:
    """Return the number of rows in runs of equal extreme values."""
    total = 0
    for extreme in (values.max(), values.min()):
        rows = np.flatnonzero(values == extreme)
        if len(rows) < CLIPPED:
            continue
        runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
        total += sum(len(run) for run in runs if len(run) >= CLIPPED)
    return total


def _resolution(values: Array) -> float:
    """Return the step between the values if they are quantised, else 0."""
    levels = np.unique(values[:20_000])
    if len(levels) < 3 or len(levels) > min(len(values), 20_000) / 4:
        return 0.0
    return float(np.median(np.diff(levels)))


def check_offsets(channels: dict[str, Array], log: Log, rated: float) -> list[Item]:
    """Return items on current offsets; they come from rows at rest and the sum of three phases."""
    names = [name for name in CURRENTS[log.current_frame] if name in channels]
    if log.current_frame == "dq":
        return [_undetermined_offsets("currents are in rotor coordinates; record phase currents")]
    current = np.stack([channels[name] for name in names])
    rest = _find_rest(channels, log, current)
    items = []
    if rest.sum() >= REST_ROWS:
        for name, values in zip(names, current, strict=True):
            resting = values[rest]
            resting = resting[np.isfinite(resting)]
            std = float(resting.std() / np.sqrt(len(resting) / 10))
            mean = float(resting.mean())
            verdict = flag_if(abs(mean) - 2 * std > OFFSET * rated)
            words = f"{mean / rated:+.2%} of the rated current, in {len(resting)} rows at rest"
            items.append(Item(f"offset of {name}", verdict, words, mean, std, "A"))
    else:
        items.append(_undetermined_offsets("record half a second of them, or of zero voltage"))
    if len(names) == 3 and tuple(names) == PHASE_CURRENTS:
        items += _check_sum(current, rated)
    return items


def _undetermined_offsets(test: str) -> Item:
    words = f"the log has no rows at rest with the bridge off: {test}"
    return Item("offsets of the current sensors", "cannot be told", words)


def _find_rest(channels: dict[str, Array], log: Log, current: Array) -> NDArray[np.bool_]:
    voltage = [v for n, v in channels.items() if n.startswith(("u_", "d_"))]
    if not voltage:
        return np.zeros(current.shape[1], bool)
    u = np.stack(voltage)
    if log.frame == "duty":
        u = u - u.mean(axis=0)
    small_voltage = np.abs(u).max(axis=0) <= REST_VOLTAGE * float(np.nanpercentile(np.abs(u), 99))
    small_current = np.abs(current).max(axis=0) <= REST_CURRENT * float(
        np.nanpercentile(np.abs(current), 99)
    )
    rest = small_voltage & small_current
    # Keep only runs that are long enough.
    edges = np.flatnonzero(np.diff(np.concatenate([[0], rest.astype(int), [0]])))
    for start, stop in edges.reshape(-1, 2):
        if stop - start < REST_ROWS // 2:
            rest[start:stop] = False
    return np.asarray(rest, bool)


def _check_sum(current: Array, rated: float) -> list[Item]:
    """Return items on the sum of the phase currents: its constant gives offsets, the rest gains.

    With gains g, the sum is (1 - g_c/g_a) i_a + (1 - g_c/g_b) i_b of the measured currents.
    """
    finite = current[:, np.isfinite(current).all(axis=0)]
    if finite.shape[1] < 100:
        return []
    total = finite.sum(axis=0)
    # Two phases suffice: the third current is minus the sum of both.
    A = np.stack([finite[0], finite[1], np.ones(finite.shape[1])], axis=1)
    coefficients = np.linalg.lstsq(A, total, rcond=None)[0]
    residual = total - A @ coefficients
    stds = np.sqrt(np.diag(np.linalg.pinv(A.T @ A))) * residual.std() * 3.0
    items = []
    mean, std = float(coefficients[2]), float(stds[2])
    verdict = flag_if(abs(mean) - 2 * std > 2 * OFFSET * rated)
    items.append(Item("sum of the three offsets", verdict, "", mean, std, "A"))
    for k, name in enumerate(("i_a", "i_b")):
        ratio = 1 / (1 - float(coefficients[k]))
        gain, error = 100 * (ratio - 1), 100 * float(stds[k]) * ratio**2
        if ratio < 0:
            words = f"{name} or i_c has the opposite sign: --scale {name}=-1 if i_c is right"
            items.append(Item(f"gain of {name}", "look at it", words))
            continue
        verdict = flag_if(abs(gain) - 2 * error > 100 * GAIN)
        words = "larger than the gain of i_c"
        items.append(Item(f"gain of {name}", verdict, words, gain, error, "%"))
    return items


def rated_current(machine: RotatingMachine, channels: dict[str, Array]) -> float:
    """Return the rated current [A], or the largest current of the log if unknown."""
    if machine.rated_current:
        return machine.rated_current
    currents = [values for name, values in channels.items() if name.startswith("i_")]
    return float(np.nanmax(np.abs(np.concatenate(currents)))) or 1.0
