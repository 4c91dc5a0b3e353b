"""Segments of a log: gaps, spikes, lengths, choice; each limit is tested from both sides."""

import numpy as np
import pytest

from fluxobs.checking.segments import (
    _bridge_gaps,
    _choose_distant,
    _clean,
    _limit_resistance,
    _moving_mean,
    _segment_length,
    cut_segments,
    without_spikes,
)
from fluxobs.errors import FluxobsError
from fluxobs.logs import read_log
from support.records import PMSM, log_columns, steady

LINE = np.arange(40) * (2 - 1j)


@pytest.mark.parametrize(("length", "bridged"), [(1, True), (5, True), (6, False)])
def test_gaps_of_five_rows_are_bridged(length, bridged):
    gapped = LINE.copy()
    gapped[10 : 10 + length] = np.nan
    gapped[30] = np.nan
    filled = _bridge_gaps(gapped)
    expected = LINE.copy()
    if not bridged:
        expected[10 : 10 + length] = np.nan
    np.testing.assert_allclose(filled, expected)


def test_gaps_at_the_ends_hold_the_nearest_value():
    gapped = LINE.copy()
    gapped[:2] = gapped[-1:] = np.nan
    filled = _bridge_gaps(gapped)
    assert filled[0] == filled[1] == LINE[2]
    assert filled[-1] == LINE[-2]
    assert np.isnan(_bridge_gaps(np.full(9, np.nan + 0j))).all()


@pytest.mark.parametrize(("value", "measured"), [(0.9e12, True), (1.1e12, False), (np.inf, False)])
def test_an_implausible_value_is_a_gap(value, measured):
    values = np.full(20, 1.0 + 0j)
    values[7] = value
    assert (_bridge_gaps(values)[7] == value) == measured
    values[6:9] = value  # too long for a spike
    assert np.isfinite(without_spikes(values)[0][7]) == measured


def noisy(count=2001):
    """Return a signal in which every row is 1 away from the line between its neighbours."""
    return 0.5 * (-1.0) ** np.arange(count) + 0j


@pytest.mark.parametrize(("distance", "spike"), [(28.9, False), (30.9, True)])
def test_a_spike_exceeds_thirty_times_the_median_distance(distance, spike):
    values = noisy()
    values[1000] += distance
    mended, count = without_spikes(values)
    assert count == spike
    assert mended[1000] == (values[999] if spike else values[1000])


@pytest.mark.parametrize(("share", "spike"), [(0.45, False), (0.55, True)])
def test_a_spike_exceeds_half_of_the_signals_deviation(share, spike):
    wave = 100 * np.exp(1e-3j * np.arange(20_000))
    wave[7000] *= 1 + share * np.std(wave) / 100
    assert without_spikes(wave)[1] == spike


@pytest.mark.parametrize(("change", "spike"), [(9.9, True), (10.1, False)])
def test_a_spike_exceeds_twice_the_difference_of_its_neighbours(change, spike):
    values = np.where(np.arange(1000) < 500, 0.0, change) + 0j
    values[500] = change / 2 + 20.0  # 20 away from the line between rows 499 and 501
    assert without_spikes(values)[1] == spike


def test_a_spike_is_one_row_but_never_the_first_or_last():
    values = np.zeros(1000, complex)
    values[[0, 300, 303, 600, 999]] = 5.0
    mended, count = without_spikes(values)
    assert count == 3
    np.testing.assert_array_equal(np.flatnonzero(mended), [0, 999])
    assert without_spikes(np.full(9, np.nan + 0j))[1] == 0


def test_clean_removes_gaps_and_spikes():
    values = np.stack([np.cos(0.01 * np.arange(500)), np.sin(0.01 * np.arange(500))], axis=1)
    clean = np.exp(0.01j * np.arange(500))
    values[100] = np.nan
    values[200] += 30.0
    np.testing.assert_allclose(_clean(values), clean, atol=1e-4)


@pytest.mark.parametrize(
    ("speed", "count", "rows"),
    [
        (100.0, 9000, 1885),  # three turns
        (-100.0, 9000, 1885),
        (1000.0, 9000, 500),  # A segment lasts at least 0.05 s.
        (100.0, 1500, 1500),  # A segment has at most all rows.
    ],
)
def test_a_segment_lasts_three_turns(speed, count, rows):
    h = 1e-4
    turning = np.exp(1j * speed * h * np.arange(count))
    assert _segment_length([turning, turning[: count // 2]], h) == rows
    assert _segment_length([turning[:10], turning], h) == rows


def test_a_segment_has_at_least_a_hundred_rows():
    assert _segment_length([np.exp(1j * np.arange(4000.0))], 1e-2) == 100
    assert _segment_length([np.ones(4000, complex)], 1e-2) == 100


def test_the_speed_comes_from_blocks_with_high_voltage():
    h = 1e-4
    slow, fast = (np.exp(1j * w * h * np.arange(5120)) for w in (50.0, 200.0))
    turns = round(3 * 2 * np.pi / 200 / h)
    assert _segment_length([0.4 * slow, 0.45 * slow, fast], h) == turns
    slow_turns = round(3 * 2 * np.pi / 50 / h)
    assert _segment_length([0.6 * slow, 0.6 * slow, fast], h) == min(slow_turns, 5120)


def test_the_resistance_is_limited_by_the_log():
    i = np.exp(0.1j * np.arange(200))
    i[7] = np.nan
    u = 2.5 * i + 9j * i
    assert _limit_resistance([u, u], [i, i], 3.6) == pytest.approx(2.5)
    assert _limit_resistance([u], [i], 1.6) == 1.6
    assert _limit_resistance([-u], [i], 3.6) == 0.0
    assert _limit_resistance([0 * u], [0 * i], 3.6) == 0.0


def test_distant_features_are_chosen():
    """The first choice has the largest first feature; later choices are far from the others."""
    features = np.array([[0.0, 0], [1.0, 0], [0.9, 0], [0.4, 0], [0.0, 0.9]] + [[0.95, 0.01]] * 7)
    distances = np.linalg.norm(features[:, None] - features, axis=2)
    chosen = [1]
    while len(chosen) < 10:
        remaining = [k for k in range(len(features)) if k not in chosen]
        chosen.append(max(remaining, key=lambda k: min(distances[k, n] for n in chosen)))
    assert _choose_distant(features) == sorted(chosen)
    assert _choose_distant(features[:3]) == [0, 1, 2]


def log_of(rows=12_000, speed=300.0, spoil=None):
    columns = log_columns(steady(PMSM, 1e-4, speed, rows, 4j))
    if spoil is not None:
        spoil(columns)
    return read_log(columns)


def test_segments_of_a_steady_log():
    log = log_of()
    segments = cut_segments(log, PMSM)
    rows = round(3 * 2 * np.pi / 300 / 1e-4)
    assert segments.current.shape == (10, rows)
    assert set(segments.voltage) == {-2, -1, 0, 1, 2}
    assert segments.truth is None
    for lag in (-2, -1, 1, 2):  # these are the voltages of shifted intervals
        shifted, given = segments.voltage[lag], segments.voltage[0]
        overlap = (shifted[:, 5:-5], given[:, 5 - lag : rows - 5 - lag])
        other = (shifted[:, 5:-5], given[:, 5 + lag : rows - 5 + lag])
        error = min(np.abs(a - b).max() for a, b in (overlap, other))
        assert error < 1e-6 * np.abs(given).max()


def test_slow_segments_are_skipped():
    """A segment is slow if its EMF is below 15 % of the largest EMF."""
    fast = np.arange(24_000) < 12_000
    for slow, kept in ((48.0, True), (40.0, False)):
        samples = steady(PMSM, 1e-4, np.where(fast, 300.0, slow), 24_000, 1e-3j)
        segments = cut_segments(read_log(log_columns(samples)), PMSM)
        turning = np.abs(np.unwrap(np.angle(segments.voltage[0]))[:, [0, -1]] @ [-1, 1])
        assert (turning.min() < 0.2 * turning.max()) == kept


def test_a_log_of_gaps_is_refused():
    def spoil(columns):
        for first in range(0, 12_000, 400):
            columns["i_alpha"][first : first + 9] = np.nan

    with pytest.raises(FluxobsError, match="no 628 consecutive rows are free of gaps"):
        cut_segments(log_of(spoil=spoil), PMSM)


def test_the_mean_that_removes_an_injection():
    """An alternating signal goes; a slope stays, and a missing row stays missing."""
    signal = LINE + 5.0 * (-1.0) ** np.arange(len(LINE))
    mean = _moving_mean(signal, 8)
    inner = slice(4, -4)
    np.testing.assert_allclose(mean[inner], LINE[inner] - 0.5 * (2 - 1j), atol=1e-9)
    signal[20] = np.nan
    assert np.isnan(_moving_mean(signal, 8)).sum() == 1
