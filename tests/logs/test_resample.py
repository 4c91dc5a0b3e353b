"""Resampled signals at their limits, compared with closed forms and brute force."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fluxobs import Record, RecordError
from fluxobs.logs.record import check_lag
from fluxobs.logs.time.resample import course_of, resample

RNG = np.random.default_rng(4)
S = np.cumsum(RNG.uniform(0.5, 1.5, 30))
INSIDE = np.sort(RNG.uniform(S[0], S[-1], 200))


@pytest.mark.parametrize(
    ("channel", "course"),
    [
        *(("u_a", "held"), ("d_b", "held"), ("theta_e", "angle"), ("theta_mech", "angle")),
        *(("hall", "state"), ("hall_a", "state"), ("i_a", "smooth"), ("udc", "smooth")),
    ],
)
def test_the_course_of_a_channel(channel, course):
    assert course_of(channel) == course


@given(c=st.lists(st.floats(-2, 2), min_size=4, max_size=4))
def test_a_cubic_is_reproduced_at_all_times(c):
    values = resample("smooth", S, np.polyval(c, S - 15), INSIDE, 1.0)
    np.testing.assert_allclose(values, np.polyval(c, INSIDE - 15), atol=1e-8)


def test_four_samples_around_a_time_are_used():
    """A missing sample invalidates its own time and the two intervals on each side."""
    values = np.where(np.arange(30) == 10, np.nan, 1.0)
    missing = np.isnan(resample("smooth", S, values, INSIDE, 1.0))
    np.testing.assert_array_equal(missing, (S[8] < INSIDE) & (S[12] > INSIDE))
    at_samples = resample("smooth", S, values, S, 1.0)
    np.testing.assert_array_equal(np.isnan(at_samples), np.arange(30) == 10)


def test_at_the_ends_the_nearest_four_are_used():
    values = np.where(np.arange(30) == 3, np.nan, 1.0)
    first = resample("smooth", S, values, np.array([(S[0] + S[1]) / 2]), 1.0)
    last = resample("smooth", S[::-1] * -1, values, np.array([-(S[0] + S[1]) / 2]), 1.0)
    assert np.isnan(first).all()
    assert np.isfinite(last).all()
    values = np.where(np.arange(30) == 4, np.nan, 1.0)
    assert np.isfinite(resample("smooth", S, values, np.array([(S[0] + S[1]) / 2]), 1.0)).all()


def test_three_samples_are_too_few():
    line = np.arange(4.0)
    assert np.isnan(resample("smooth", line[:3], line[:3], np.array([1.0]), 1.0)).all()
    assert resample("smooth", line, line, np.array([1.5]), 1.0) == pytest.approx(1.5)


@pytest.mark.parametrize("course", ["smooth", "angle"])
def test_values_beyond_the_ends_are_missing_within_rounding(course):
    s = np.arange(10.0)
    t = np.array([-1e-5, -1e-7, 9 + 1e-7, 9 + 1e-5])
    finite = np.isfinite(resample(course, s, s / 10, t, 1.0))
    assert finite.tolist() == [False, True, True, False]


def test_an_angle_wraps_and_goes_on_across_missing_values():
    angle = np.mod(0.9 * S + 2.0, 2 * np.pi)
    angle[10] = np.nan
    resampled = resample("angle", S, angle, INSIDE, 1.0)
    far = (S[8] > INSIDE) | (S[12] < INSIDE)
    assert ((resampled[far] >= 0) & (resampled[far] < 2 * np.pi)).all()
    error = np.angle(np.exp(1j * (resampled - 0.9 * INSIDE - 2.0)))
    assert np.abs(error[far]).max() < 1e-9
    assert np.isnan(resampled[~far]).all()


def test_a_state_stays_until_the_next_and_a_step_beyond_the_last():
    s = np.array([1.0, 2.0, 4.0])
    t = np.array([0.99, 1.0, 1.99, 2.0, 3.9, 4.0, 4.5, 4.51])
    resampled = resample("state", s, np.array([5.0, 6.0, 7.0]), t, 0.5)
    np.testing.assert_array_equal(resampled, [np.nan, 5, 5, 6, 6, 7, 7, np.nan])


@given(step=st.floats(0.05, 4.0), seed=st.integers(0, 50))
def test_means_of_a_held_signal(step, seed):
    """Compare with a sum over samples, weighted by the time that each sample is held."""
    values = np.random.default_rng(seed).normal(size=30)
    t = INSIDE[INSIDE + step < S[-1]]
    ends = np.append(S[1:], 2 * S[-1] - S[-2])
    overlap = np.minimum(ends, t[:, None] + step) - np.maximum(S, t[:, None])
    expected = np.clip(overlap, 0, None) @ values / step
    np.testing.assert_allclose(resample("held", S, values, t, step), expected, atol=1e-9)


def test_the_last_held_value_lasts_as_long_as_the_one_before():
    s = np.array([0.0, 1.0, 4.0])
    t = np.array([-2e-6, -5e-7, 5.9999995, 6.000005])
    finite = np.isfinite(resample("held", s, np.array([1.0, 2.0, 3.0]), t, 1.0))
    assert finite.tolist() == [False, True, True, False]
    assert resample("held", s, np.array([1.0, 2.0, 3.0]), np.array([5.5]), 1.0) == 3.0


def test_a_held_mean_is_missing_if_any_share_of_it_is():
    s, values = np.arange(6.0), np.array([1.0, 1.0, np.nan, 1.0, 1.0, 1.0])
    t = np.array([0.5, 1.0, 1.0000005, 1.00001, 2.5, 2.99999, 2.9999995, 3.0])
    means = resample("held", s, values, t, 1.0)
    np.testing.assert_array_equal(np.isnan(means), [0, 0, 0, 1, 1, 1, 0, 0])


# ---- records --------------------------------------------------------------------------------


def test_a_record_serves_observers_of_its_own_sample_time():
    """Sample times may differ by one in a thousand, because clocks are inaccurate."""
    record = Record(1e-3, np.ones((30, 2)), np.zeros((30, 2)), lag=-1.0)
    voltage, current = record.on_intervals(1.0009e-3)
    np.testing.assert_array_equal(np.isnan(voltage[:, 0]), np.arange(30) < 2)
    assert current is record.current
    for sample_time in (1.0012e-3, 0.9988e-3):
        with pytest.raises(
            RecordError, match=f"is 0.001 s, but the observer's is {sample_time:g} s"
        ):
            record.on_intervals(sample_time)
    np.testing.assert_allclose(record.t, 1e-3 * np.arange(30))


@pytest.mark.parametrize("lag", [28.9, -28.9, 0.0])
def test_a_lag_inside_the_record(lag):
    check_lag(lag, 30)


@pytest.mark.parametrize("lag", [29.0, -29.0, 1000.0])
def test_a_lag_that_leaves_no_voltage(lag):
    with pytest.raises(RecordError, match=rf"lag of {lag:g} samples .* of 30 rows"):
        check_lag(lag, 30)


@pytest.mark.parametrize("lag", [np.nan, np.inf])
def test_a_lag_that_is_no_number(lag):
    with pytest.raises(RecordError, match="lag must be a number of samples"):
        check_lag(lag, 30)


def test_records_of_three_phases_and_complex_numbers():
    z = np.exp(0.2j * np.arange(30))
    turn = np.exp(2j * np.pi / 3 * np.arange(3))
    phases = (z[:, None] * turn.conj()).real + 0.5
    record = Record(1e-3, phases, z)
    np.testing.assert_allclose(record.voltage, record.current, atol=1e-12)
    for shape in ((30,), (30, 1), (30, 4), (2, 30, 2)):
        with pytest.raises(RecordError, match="voltage must have shape"):
            Record(1e-3, np.zeros(shape), z)
    with pytest.raises(RecordError, match=r"got \(30, 2\) complex"):
        Record(1e-3, np.zeros((30, 2), complex), z)


def test_true_angles_of_a_record_have_its_rows():
    z = np.zeros(30, complex)
    assert Record(1e-3, z, z, theta_e=np.arange(30)).theta_e.dtype == float
    with pytest.raises(RecordError, match=r"theta_e must have shape \(30,\), got \(29,\)"):
        Record(1e-3, z, z, theta_e=np.zeros(29))
    for wrong in (0.0, -1.0, np.inf):
        with pytest.raises(RecordError, match="sample_time must be positive"):
            Record(wrong, z, z)
