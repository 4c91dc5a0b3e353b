"""Marks of quality: faults are found, and clean signals carry none."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fluxobs
from fluxobs.logs.quality.detect import Detector, bridged
from fluxobs.logs.quality.marks import (
    CLIPPED,
    FAULTS,
    HELD,
    MARKS,
    MISSING,
    NO_CURRENT,
    OUTLIER,
    RANGE,
    REPEATED,
    names_of,
)
from fluxobs.logs.time.aligned import Aligned
from fluxobs.machines import example_names
from support.records import SERVO, driven, log_columns

H, ROWS = 1e-4, 8000
T = H * np.arange(ROWS)
RNG = np.random.default_rng(3)
NOISE = RNG.standard_normal((ROWS, 2))


def signals(speed=400.0, size=8.0, noise=0.02, rest=0.0):
    """Return rows of a current that turns, after a rest, with its voltage."""
    angle = speed * np.clip(T - rest, 0, None)
    i = size * np.exp(1j * angle)
    u = 0.0125 * speed * 1j * np.exp(1j * angle) * (rest < T) + 0.36 * i
    vectors = [np.stack([x.real, x.imag], axis=1) for x in (i, u)]
    return Aligned(T, vectors[0] + noise * NOISE, vectors[1], None)


def stopping():
    """Return a current that turns, stops for 0.2 s, and turns on, without noise."""
    speed = np.interp(T, [0.2, 0.3, 0.5, 0.6], [300.0, 0.0, 0.0, 300.0])
    angle = np.cumsum(speed) * H
    i = 8.0 * np.exp(1j * angle)
    u = 0.0125 * speed * 1j * np.exp(1j * angle) + 0.36 * i
    return Aligned(T, *(np.stack([x.real, x.imag], axis=1) for x in (i, u)), None)


def marks(rows, noise=0.02):
    return Detector(8.0, 10.0, noise).marks(rows)


def quantised(values, bits, full=12.0):
    step = 2 * full / 2**bits
    return step * np.round(values / step)


CLEAN = {
    "noisy": signals(),
    "without noise": signals(noise=0.0),
    "slow without noise": signals(speed=2.0, noise=0.0),
    "rest without noise": signals(speed=0.0, noise=0.0),
    "rest, then motion": signals(noise=0.0, rest=0.3),
    "a stop without noise": stopping(),
    "8 bits": signals()._replace(current=quantised(signals().current, 8)),
    "8 bits, slow": signals(speed=5.0)._replace(current=quantised(signals(speed=5.0).current, 8)),
    "12 bits without noise": signals(noise=0.0)._replace(
        current=quantised(signals(noise=0.0).current, 12)
    ),
    "8 bits, slow, without noise": signals(speed=5.0, noise=0.0)._replace(
        current=quantised(signals(speed=5.0, noise=0.0).current, 8)
    ),
    "text with three digits": signals()._replace(current=np.round(signals().current, 3)),
    "filtered": signals()._replace(
        current=np.stack([np.convolve(x, np.ones(8) / 8, "same") for x in signals().current.T], 1)
    ),
}


@pytest.mark.parametrize("name", CLEAN)
def test_clean_signals_carry_no_fault(name):
    rows = CLEAN[name]
    found = marks(rows)
    faulty = np.flatnonzero(found & FAULTS)
    assert len(faulty) <= 1e-5 * ROWS, [names_of(int(found[k])) for k in faulty[:3]]


# The closed-form records are those of synchronous machines.
SYNCHRONOUS = [
    name
    for name in example_names()
    if not fluxobs.example(name).kind.startswith(("maglev", "induction"))
]


@pytest.mark.parametrize("machine", SYNCHRONOUS)
def test_a_clean_log_of_every_machine_carries_no_fault(machine):
    machine = fluxobs.example(machine)
    rated = machine.rated_current or 5.0
    t = H * np.arange(6000)
    speed = np.interp(t, [0, 0.2, 0.4, 0.6], [50, 400, 400, -200])
    i_dq = rated * (0.3 + 0.5j) * np.interp(t, [0, 0.1, 0.3, 0.302], [0.2, 1, 1, -0.7])
    samples = driven(machine, H, speed, i_dq, noise=0.002 * rated)
    result = fluxobs.estimate(log_columns(samples), machine, lag=0, causal=True)
    assert not (np.asarray(result["quality"]) & FAULTS).any()


def test_repeated_rows():
    rows = signals()
    current, voltage = rows.current.copy(), rows.voltage.copy()
    current[3000:3050], voltage[3000:3050] = current[2999], voltage[2999]
    faulty = rows._replace(current=current, voltage=voltage)
    found = marks(faulty)
    assert (np.flatnonzero(found & REPEATED) == np.arange(3000, 3050)).all()
    mended = Detector(8.0, 10.0, 0.02).marked(faulty)
    assert np.isnan(mended.voltage[3000:3050]).all()
    assert np.isfinite(mended.voltage[:3000]).all()
    # 50 rows are 2 rad: the current is bridged.
    np.testing.assert_allclose(mended.current[3000:3050], rows.current[3000:3050], atol=0.15)


def test_a_held_current():
    rows = signals()
    current = rows.current.copy()
    current[3000:3003] = current[2999]
    found = marks(rows._replace(current=current))
    assert (np.flatnonzero(found & HELD) == np.arange(3000, 3003)).all()


def test_clipped_phases():
    rows = signals()
    a = np.clip(rows.current[:, 0], -6, 6)
    b = np.clip(-rows.current[:, 0] / 2 + 0.75**0.5 * rows.current[:, 1], -6, 6)
    current = np.stack([a, (a + 2 * b) / 3**0.5], axis=1)
    found = marks(rows._replace(current=current)) & CLIPPED > 0
    changed = np.abs(current - rows.current).max(axis=1) > 1e-9
    assert found[changed].mean() > 0.999
    assert found[~changed].mean() < 0.2  # neighbours of clipped rows
    mended = Detector(8.0, 10.0, 0.02).marked(rows._replace(current=current))
    difference = np.abs(mended.current - rows.current)[changed].max(axis=1)
    assert np.isfinite(difference).mean() > 0.9
    assert np.nanmax(difference) < 0.3  # 2 A were cut off


def test_single_faults():
    rows = signals()
    current, voltage = rows.current.copy(), rows.voltage.copy()
    current[1000] += 10.0
    current[2000:2002] -= 9.0
    current[3000] = np.nan
    voltage[4000] = np.nan
    current[5000] = 1e9
    voltage[6000] = 1e9
    found = marks(rows._replace(current=current, voltage=voltage))
    assert list(np.flatnonzero(found & OUTLIER)) == [1000, 2000, 2001]
    assert list(np.flatnonzero(found & MISSING)) == [3000, 4000]
    assert list(np.flatnonzero(found & RANGE)) == [5000, 6000]


def test_no_current_is_no_fault():
    rows = signals()
    current = rows.current.copy()
    current[2000:2500] = 0.02 * NOISE[2000:2500]
    found = marks(rows._replace(current=current))
    assert (found[2000:2500] & NO_CURRENT > 0).mean() > 0.9
    assert not (found & FAULTS).any()


def test_a_gap_of_more_than_half_a_turn_is_not_bridged():
    rows = signals(noise=0.0)
    current = rows.current.copy()
    current[3000:3100] = np.nan  # 4 rad
    assert np.isnan(bridged(current)[3000:3100]).all()


def test_the_page_shows_the_same_marks_as_faults():
    text = (Path(__file__).parents[2] / "web/app/plots.js").read_text("utf-8")
    (bits,) = re.findall(r"^const FAULTS = ([0-9 |]+);$", text, re.MULTILINE)
    assert sum(int(bit) for bit in bits.split("|")) == FAULTS


def test_every_mark_has_a_bit_of_its_own():
    bits = [2**n for mark in MARKS for n in range(16) if mark.bit & 2**n]
    assert sorted(bits) == [2**n for n in range(len(bits))]
    assert len(bits) == len(MARKS) + 2  # a floating phase has three
    assert names_of(REPEATED | CLIPPED) == ["repeated", "clipped"]


def test_a_bridge_that_is_off_is_named_and_survived():
    t = H * np.arange(16_000)
    speed = np.interp(t, [0, 0.3, 1.6], [200.0, 500.0, 400.0])
    load = 1j * np.interp(t, [0, 0.5, 0.51, 1.6], [3.0, 3.0, 8.0, 8.0])
    samples = driven(SERVO, H, speed, load, noise=0.02)
    off = slice(8000, 11_000)
    voltage, current = samples.voltage.copy(), samples.current.copy()
    u = complex(*voltage[7999]) * np.exp(1j * (samples.theta[off] - samples.theta[7999]))
    voltage[off] = np.stack([u.real, u.imag], axis=1)
    current[off] = 0.02 * np.random.default_rng(1).standard_normal((3000, 2))
    columns = log_columns(replace(samples, voltage=voltage, current=current))
    result = fluxobs.estimate(columns, SERVO, lag=0)
    valid = result["valid"]
    error = np.abs(np.angle(np.exp(1j * (result["theta_e"] - samples.theta))))
    assert not valid[8050:10_950].any()
    assert valid[:7900].mean() > 0.95
    assert valid[11_100:].mean() > 0.95
    assert np.degrees(error[valid].max()) < 3
    assert any("bridge off (0.8" in text for text in result.warnings)
    assert abs(result.learnt.resistance - SERVO.R_s) < 4 * result.learnt.resistance_std
