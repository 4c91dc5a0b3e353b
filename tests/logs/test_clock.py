"""Clocks, computed by hand: rows and times of a log with gaps; limits of rounding, steps, wraps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fluxobs import RecordError, read_log
from fluxobs.logs.time.clock import (
    INDEXED,
    Clock,
    even,
    is_rounded,
    longest_step,
    missing_steps,
    rounded_rate,
    rounding_of,
)

H = 1e-3
#: Rows 0 … 9 of the file, three missing rows, rows 10 … 19, a gap shortened from 1 s to 4 rows, and
#: the remaining rows.
GAPS = Clock(
    H,
    5.0,
    37,
    np.array([0, 10, 20]),
    np.array([0, 13, 27]),
    np.array([5.0, 5.013, 6.022]),
    1003,
    0.0,
    0.0,
    np.zeros(1),
    0.0,
)


def test_times_of_rows_in_pieces_and_gaps():
    t = GAPS.times(np.arange(GAPS.rows))
    np.testing.assert_allclose(t[:27], 5.0 + H * np.arange(27), atol=1e-12)
    np.testing.assert_allclose(t[27:], 6.022 + H * np.arange(10), atol=1e-12)
    assert GAPS.end == pytest.approx(t[-1])


def test_within_a_gap_that_loses_time_rows_stay_before_its_end():
    """The stamp after a gap may be earlier than the number of missing samples suggests."""
    early = Clock(
        *(H, 0.0, 20, np.array([0, 5]), np.array([0, 10]), np.array([0.0, 0.0071])),
        *(5, 0.0, 0.0, np.zeros(1), 0.0),
    )
    t = early.times(np.arange(20))
    np.testing.assert_allclose(t[:8], H * np.arange(8), atol=1e-15)
    np.testing.assert_allclose(t[8:10], 0.0071, rtol=1e-9)
    assert (t[8:10] < 0.0071).all()
    np.testing.assert_allclose(t[10:], 0.0071 + H * np.arange(10), atol=1e-15)


def test_rows_of_the_file_among_the_uniform_rows():
    source = np.arange(30)
    expected = np.concatenate([np.arange(10), 13 + np.arange(10), 27 + np.arange(10)])
    np.testing.assert_array_equal(GAPS.uniform_rows(source), expected)


@pytest.mark.parametrize(
    ("clock", "offsets"),
    [(GAPS, (-0.4, 0.0, 0.4)), (even(40, H, 5.0), (-0.4, -5e-7, 0.0, 5e-7, 0.4))],
)
def test_the_row_at_a_time(clock, offsets):
    """With `up`: first row at or after the time. Without: row after the last row up to the time."""
    t = clock.times(np.arange(clock.rows))
    for at in (row + offset * H for row in t for offset in offsets):
        assert clock.row_at(at, up=True) == np.sum(t < at - 1e-6 * H)
        assert clock.row_at(at, up=False) == np.sum(t <= at + 1e-6 * H)


@pytest.mark.parametrize("clock", [GAPS, even(40, H, 5.0)])
def test_times_outside_of_a_log(clock):
    for t, row in ((4.0, 0), (60.0, clock.rows)):
        assert (clock.row_at(t, up=True), clock.row_at(t, up=False)) == (row, row)


def test_times_inside_a_shortened_gap():
    assert GAPS.row_at(5.5, up=True) == 27
    assert GAPS.row_at(5.5, up=False) == 27


def test_an_even_clock():
    clock = even(130, 0.5, 2.0)
    assert (clock.sample_time, clock.t0, clock.rows, clock.end) == (0.5, 2.0, 130, 66.5)
    assert (clock.missing, clock.rounding, clock.jitter, clock.wrap) == (0, 0.0, 0.0, 0.0)
    assert clock.plain
    np.testing.assert_array_equal(clock.index, 2.0 + 0.5 * np.array([0, INDEXED, 2 * INDEXED]))
    assert even(130, 0.5).t0 == 0.0
    assert not GAPS.plain


@pytest.mark.parametrize(
    ("steps", "missing"),
    [(1.0, 0), (1.59, 0), (1.61, 1), (2.4, 1), (2.6, 2), (3.0, 2), (100.0, 99)],
)
def test_samples_that_are_missing_in_a_step(steps, missing):
    """A step is a gap from 1.6 samples on; the gap is a whole number of samples."""
    assert missing_steps(np.array([steps * H]), H, 0.0).tolist() == [missing]


def test_rounding_allows_for_longer_steps_if_it_is_worth_a_word():
    assert longest_step(H, 0.0) == pytest.approx(1.6 * H)
    assert longest_step(H, 0.19 * H) == pytest.approx(1.6 * H)
    assert longest_step(H, 0.21 * H) == pytest.approx(1.81 * H)
    assert missing_steps(np.array([2 * H, 2.3 * H, 2.7 * H]), H, H).tolist() == [0, 0, 2]


@pytest.mark.parametrize("size", [digit * 10.0**-n for n in range(1, 7) for digit in (1, 2, 5)])
@pytest.mark.parametrize("step", [0.3, 0.9, 1.7, 4.3, 37.7])
def test_the_digits_of_stamps(size, step):
    """Only differences of stamps count: the first stamp may have any value."""
    t = size * np.round(step * np.arange(1000)) + 1.2345
    assert rounding_of(t) == pytest.approx(size)


def test_stamps_with_many_digits_have_no_rounding():
    assert rounding_of(np.sqrt(np.arange(1.0, 1000.0))) == 0.0
    assert rounding_of(np.zeros(50)) == 0.0


@pytest.mark.parametrize(("share", "rounded"), [(0.9, True), (0.6, True), (0.4, False)])
def test_rounded_stamps_stay_at_a_line_in_most_windows(share, rounded):
    rows = 256
    windows = []
    for n in range(100):
        stamps = np.round(1.37 * (np.arange(rows) + n * rows))
        if n >= 100 * share:
            stamps[rows // 2 :] += 7
        windows.append(stamps)
    assert is_rounded(np.concatenate(windows), 1.0) == rounded


def test_a_line_is_left_by_no_more_than_the_rounding():
    k = np.arange(256.0)
    wave = np.where(k % 2, 0.5, -0.5)
    assert is_rounded(3 * k + wave, 1.0)
    assert is_rounded(3 * k + 1.05 * wave, 1.0)
    assert not is_rounded(3 * k + 1.15 * wave, 1.0)
    assert is_rounded(3 * k[:30], 1.0)
    assert not is_rounded(3 * k[:30] + 1.2 * wave[:30], 1.0)


@pytest.mark.parametrize(
    ("step", "uncertain", "expected"),
    [
        (1.00003e-4, 1e-8, 1e-4),
        (1.00003e-4, 2e-9, 1.00003e-4),
        (1 / 16384.02, 1e-8, 6.104e-5),
        (1 / 16384.02, 1e-10, 1 / 16384),
        (1 / 16384.02, 7e-11, 6.10351e-5),
        (1.25e-4, 0.0, 1.25e-4),
        (1 / 3, 0.0, 0.333333333),
    ],
)
def test_the_shortest_rate_or_step_that_agrees(step, uncertain, expected):
    assert rounded_rate(step, uncertain) == pytest.approx(expected, rel=1e-8)


@given(rate=st.integers(1, 999), power=st.integers(-2, 3))
def test_round_rates_are_found_through_rounding(rate, power):
    h = 1 / (rate * 10.0**power)
    assert rounded_rate(h * (1 + 1e-7), 2e-7 * h) == pytest.approx(h, rel=1e-8)


def log(t):
    z = np.exp(0.1j * np.arange(len(t)))
    columns = {"t": t, "u_alpha": z.real, "u_beta": z.imag, "i_alpha": z.real, "i_beta": z.imag}
    return columns


@pytest.mark.parametrize(("deviation", "jitters"), [(0.018, False), (0.022, True)])
def test_steps_within_two_percent_are_even(deviation, jitters):
    t = H * np.arange(400)
    t[200] += deviation * H
    assert (read_log(log(t)).clock.jitter > 0) == jitters


@pytest.mark.parametrize(("given", "limit"), [(None, 0.45), (H, 0.9)])
def test_the_largest_deviation_of_a_step(given, limit):
    """The message names the place of the worst step."""
    t = H * np.arange(400)
    t[200:] -= (limit - 0.01) * H
    read_log(log(t), sample_time=given)
    t[200:] -= 0.02 * H
    message = f"row 201: samples are not uniform: a step of .* Steps may differ by {limit:.0%}"
    with pytest.raises(RecordError, match=message):
        read_log(log(t), sample_time=given)


@pytest.mark.parametrize(("share", "agrees"), [(0.0009, True), (0.0051, False)])
def test_a_sample_time_that_is_given_must_agree(share, agrees):
    t = H * (1 + share) * np.arange(2000)
    if agrees:
        assert read_log(log(t), sample_time=H).sample_time == H
    else:
        with pytest.raises(RecordError, match=r"t advances by 0\.0010051 s a row, but"):
            read_log(log(t), sample_time=H)


@pytest.mark.parametrize(("lost", "joined"), [(14, True), (17, False)])
def test_a_wrap_may_lose_sixteen_samples(lost, joined):
    """A longer step is not the wrap of a counter, but an error."""
    rows = np.delete(np.arange(300), slice(150, 150 + lost))
    t = np.mod(rows * 1e-4 + (2**16 / 1e6 - 0.01505), 2**16 / 1e6)
    if joined:
        assert read_log(log(t)).clock.wrap == pytest.approx(2**16 / 1e6)
    else:
        with pytest.raises(RecordError, match="time runs backwards"):
            read_log(log(t))


def test_the_place_where_time_runs_backwards():
    t = H * np.arange(50)
    t[20:] -= 0.0055
    message = r"row 21: time runs backwards or stands still, 0\.019 s then 0\.0145 s"
    with pytest.raises(RecordError, match=message):
        read_log(log(t))


def log_at(stamps, **given):
    k = np.arange(len(stamps))
    axes = {"u_alpha": np.cos(k), "u_beta": np.sin(k), "i_alpha": np.sin(k), "i_beta": np.cos(k)}
    return read_log({"t": stamps} | axes, **given)


def test_a_given_sample_time_is_confirmed_by_the_mean_or_by_the_usual_step():
    """A gap changes the mean step; rounding changes the usual step."""
    gap = 4e-4 * np.concatenate([np.arange(300), np.arange(420, 900)])
    assert log_at(gap, sample_time=4e-4).sample_time == pytest.approx(4e-4)
    rounded = np.round(4e-4 * np.arange(2001), 3)
    assert log_at(rounded, sample_time=4e-4).sample_time == pytest.approx(4e-4)
    for stamps in (gap, rounded):
        for wrong in (8e-4, 2e-4):
            with pytest.raises(RecordError, match=f"but sample_time is {wrong:g} s"):
                log_at(stamps, sample_time=wrong)
