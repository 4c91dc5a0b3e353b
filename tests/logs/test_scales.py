"""Sizes of signals: known noise and speeds are recovered from all excerpts."""

from pathlib import Path

import numpy as np
import pytest

from fluxobs import Record, RecordError, read_log
from fluxobs.logs import scales
from fluxobs.logs.quality.noise import white_noise
from fluxobs.logs.scales import excerpts, measure_scales, scales_of
from fluxobs.logs.time.aligned import Aligned

H = 1e-3


def vectors(z):
    return np.stack([z.real, z.imag], axis=1)


def piece(current, voltage):
    return Aligned(H * np.arange(len(current)), vectors(current), vectors(voltage), None)


def measured(*pieces):
    return scales_of(pieces, H, Path("log"))


def test_noise_is_that_of_one_component_on_a_smooth_signal():
    k = np.arange(51_200)
    noise = np.random.default_rng(0).normal(0, 0.02, (len(k), 2))
    smooth = vectors(5 * np.exp(0.01j * k))
    assert white_noise(smooth + noise) == pytest.approx(0.02, rel=0.01)
    assert white_noise(smooth) < 1e-5


def test_third_differences_of_an_alternating_signal():
    """Third differences are 8 times the signal: the level is 8/√20 of it in a short block.

    From 256 differences on, the median of the spectrum shows that the signal is no noise.
    """
    for rows in (4, 5, 258, 259, 260, 700):
        signal = np.where(np.arange(rows) % 2, -1.0, 1.0)[:, None] * [0.5, 0.5]
        expected = 4 / np.sqrt(20) if rows < 259 else 0.0
        assert white_noise(signal) == pytest.approx(expected, abs=1e-12)
    assert white_noise(np.ones((3, 2))) == 0.0


def test_the_usual_block_of_256_rows_counts():
    """Noise in less than half of the blocks does not change the median of the blocks."""
    signal = np.random.default_rng(1).normal(0, 1.0, (5 * 256 + 3, 2))
    signal[2 * 256 :] *= 100
    level_of_three = white_noise(np.concatenate([signal, signal[:256]]))
    signal[2 * 256 : 3 * 256 + 3] /= 100
    assert white_noise(signal) == pytest.approx(1.0, rel=0.2)
    assert level_of_three > 50


def test_a_block_with_a_missing_value_is_left_out():
    signal = np.random.default_rng(1).normal(0, 1.0, (3 * 256 + 3, 2))
    signal[300, 0] = np.nan
    assert white_noise(signal) == pytest.approx(1.0, rel=0.1)
    assert white_noise(np.full((600, 2), np.nan)) == 0.0


def test_sizes_are_95th_percentiles():
    """The 95th percentile of lengths 0 … 100 is 95; steps of the angle are treated alike."""
    length = np.arange(101.0)
    turned = np.cumsum(np.arange(101) * 0.01)
    scales = measured(piece(length * np.exp(1j * turned), 2 * length * np.exp(0.3j)))
    assert (scales.current, scales.voltage) == pytest.approx((95.0, 190.0))
    assert scales.current_speed == pytest.approx(np.percentile(np.arange(1, 101), 95) * 0.01 / H)


def test_noise_of_pieces_is_their_median():
    alternating = np.where(np.arange(256) % 2, -1.0, 1.0) * (1 + 1j)
    scales = measured(*(piece(n * alternating, 10 * n * alternating) for n in (1, 2, 9)))
    assert scales.current_noise == pytest.approx(16 / np.sqrt(20))
    assert scales.voltage_noise == pytest.approx(160 / np.sqrt(20))


def test_a_current_in_few_rows_is_not_zero():
    current = np.where(np.arange(100) == 50, 3.0, 0.0) + 0j
    assert measured(piece(current, np.ones(100, complex))).current == 3.0


@pytest.mark.parametrize(
    ("current", "voltage", "message"),
    [
        (0, 1, "log: the current is zero in every row"),
        (1, 0, "log: the voltage is zero in every row"),
        (1e300, 1, "log: the current is 1e\\+300 A: more than any drive or counter has"),
        (1, 1e13, "log: the voltage is 1e\\+13 V: more than any drive or counter has"),
        (np.nan, 1, "log: no row has a current"),
        (1, np.nan, "log: no row has a voltage"),
    ],
)
def test_missing_and_zero_signals(current, voltage, message):
    ones = np.ones(50, complex)
    with pytest.raises(RecordError, match=message):
        measured(piece(current * ones, voltage * ones))


def rows(count):
    z = np.exp(0.1j * np.arange(count))
    return {"t": H * np.arange(count), "u_alpha": z.real, "u_beta": z.imag} | {
        "i_alpha": np.arange(count, dtype=float),
        "i_beta": z.imag,
    }


@pytest.mark.parametrize("random_access", [True, False])
@pytest.mark.parametrize("start", [None, 0.1])
def test_excerpts_are_spread_evenly(monkeypatch, random_access, start):
    """The log is long; its table has random access or not."""
    monkeypatch.setattr(scales, "EXCERPTS", 4)
    monkeypatch.setattr(scales, "EXCERPT_ROWS", 10)
    log = read_log(rows(1000), start=start)
    log.table.random_access = random_access
    spacing = len(log) // 4
    currents = [excerpt.current[:, 0].astype(int).tolist() for excerpt in excerpts(log)]
    starts = [log.first + n * spacing for n in range(4)]
    assert currents == [list(range(row, row + 10)) for row in starts]


@pytest.mark.parametrize(("count", "pieces"), [(39, 1), (40, 1), (41, 4)])
def test_a_short_log_is_one_excerpt(monkeypatch, count, pieces):
    monkeypatch.setattr(scales, "EXCERPTS", 4)
    monkeypatch.setattr(scales, "EXCERPT_ROWS", 10)
    assert len(list(excerpts(read_log(rows(count))))) == pieces


def test_sizes_of_a_log_are_those_of_its_rows():
    z = np.exp(0.1j * np.arange(1000))
    measured_scales = measure_scales(read_log(Record(H, 3 * z, 2 * z)))
    assert (measured_scales.current, measured_scales.voltage) == pytest.approx((2.0, 3.0))
    assert measured_scales.current_speed == pytest.approx(0.1 / H)
