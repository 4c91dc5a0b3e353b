"""Bad samples are bridged and counted, cause restarts, and never corrupt the state."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fluxobs import LeastSquaresObserver
from fluxobs.observers import SampleCounts
from support.records import SERVO, steady, wrapped_degrees

H, ROWS, BAD = 1e-4, 3000, 1500
OBSERVER = LeastSquaresObserver.for_machine(SERVO, sample_time=H)
SAMPLES = steady(SERVO, H, 500.0, ROWS, 4j, 0.1, 0.1, noise=0.01)


def run(voltage=None, current=None):
    u, i = SAMPLES.voltage.copy(), SAMPLES.current.copy()
    for rows, value in voltage or []:
        u[rows] = value
    for rows, value in current or []:
        i[rows] = value
    state, estimate = OBSERVER.resume(OBSERVER.init(), u, i)
    return estimate, OBSERVER.counts(state)


def error(estimate):
    return np.abs(wrapped_degrees(estimate.theta_e - SAMPLES.theta))


def test_without_bad_samples():
    estimate, counts = run()
    assert estimate.valid[500:].all()
    assert counts == SampleCounts(0, 0, 0, 0, 0)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("length", [1, 3])
def test_missing_voltage_is_held(value, length):
    estimate, counts = run(voltage=[(slice(BAD, BAD + length), value)])
    assert counts.bad_voltages == length
    assert counts.restarts == 0
    assert error(estimate)[estimate.valid].max() < 15
    assert error(estimate)[-500:].max() < 2
    assert estimate.valid[-500:].all()


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("length", [1, 3])
def test_missing_current_is_bridged_by_prediction(value, length):
    estimate, counts = run(current=[(slice(BAD, BAD + length), value)])
    assert counts.bad_currents == length
    assert counts.restarts == 0
    assert error(estimate)[estimate.valid].max() < 15
    assert estimate.valid[-500:].all()
    # Without a measurement, the innovation of the last good sample remains.
    assert estimate.innovation[BAD] == estimate.innovation[BAD - 1]


def test_a_sample_with_one_missing_component_is_missing():
    _, counts = run(current=[((BAD, 1), np.nan)], voltage=[((BAD, 0), np.nan)])
    assert (counts.bad_voltages, counts.bad_currents) == (1, 1)


@pytest.mark.parametrize("which", ["voltage", "current"])
def test_more_than_three_in_a_row_restart(which):
    estimate, counts = run(**{which: [(slice(BAD, BAD + 10), np.nan)]})
    assert counts.restarts == 1
    assert getattr(counts, f"bad_{which}s") >= 4
    assert not estimate.valid[BAD + 3 : BAD + 10].any()
    assert estimate.valid[-500:].all()
    assert error(estimate)[estimate.valid].max() < 15


@pytest.mark.parametrize("value", [1e5, -1e30, 1e300])
@pytest.mark.parametrize("which", ["voltage", "current"])
def test_an_implausible_value_restarts(which, value):
    estimate, counts = run(**{which: [(BAD, value)]})
    assert counts.absurd == 1
    assert counts.restarts == 1
    assert not estimate.valid[BAD : BAD + 50].any()
    assert estimate.valid[-500:].all()
    assert error(estimate)[estimate.valid].max() < 15


def test_a_spike_in_the_current_is_ignored():
    estimate, counts = run(current=[((BAD, 0), 80.0)])
    assert counts == SampleCounts(0, 0, 0, outliers=1, restarts=0)
    assert error(estimate)[BAD + 1 :].max() < 2
    assert not estimate.valid[BAD]
    assert estimate.valid[BAD + 10 :].all()


@pytest.mark.parametrize("size", [8.0, 20.0, 41.7, 100.0, -41.7])
def test_spikes_of_any_size_and_direction_do_not_mislead(size):
    """A spike can reverse the vector λ - L i without a change of length."""
    rows = np.arange(500, ROWS, 97)
    estimate, _ = run(current=[((row, k % 2), size) for k, row in enumerate(rows)])
    assert error(estimate)[estimate.valid].max() < 15
    assert np.abs(wrapped_degrees(estimate.theta_e_tracked - SAMPLES.theta))[600:].max() < 15
    assert estimate.valid[600:].mean() > 0.95


def test_a_spike_in_the_voltage_restarts_once_the_currents_contradict():
    estimate, counts = run(voltage=[((BAD, 0), 300.0)])  # the flux jumps by 2.4 times psi_f
    assert counts.outliers == 4
    assert counts.restarts == 1
    assert error(estimate)[estimate.valid].max() < 15
    assert estimate.valid[BAD + 500 :].all()


def test_only_missing_values():
    estimate, counts = run(voltage=[(slice(None), np.nan)], current=[(slice(None), np.nan)])
    assert not estimate.valid.any()
    assert np.isfinite(estimate.theta_e).all()
    assert counts.bad_currents == ROWS


def test_missing_start_and_later_voltage():
    estimate, counts = run(current=[(slice(0, 50), np.nan)], voltage=[(slice(0, 80), np.nan)])
    assert counts.bad_currents == 50
    assert estimate.valid[-500:].all()
    assert error(estimate)[estimate.valid].max() < 15


garbage = st.sampled_from([np.nan, np.inf, -np.inf, 0.0, 1e-300, 1e3, -1e6, 1e38, 1e308])


@settings(max_examples=60)
@given(
    bad=st.lists(
        st.tuples(st.integers(0, ROWS - 1), st.integers(0, 1), st.booleans(), garbage), max_size=40
    ),
    single=st.booleans(),
)
def test_every_output_stays_finite(bad, single):
    observer = LeastSquaresObserver.for_machine(
        SERVO, sample_time=H, precision="single" if single else "double"
    )
    u, i = SAMPLES.voltage.copy(), SAMPLES.current.copy()
    for row, component, current, value in bad:
        (i if current else u)[row, component] = value
    estimate = observer.run(u, i)
    for field in ("flux", "psi_f", "theta_e", "theta_e_tracked", "speed_e", "drift"):
        assert np.isfinite(getattr(estimate, field)).all(), field
    assert ((estimate.theta_e_std > 0) & (estimate.theta_e_std < 1.82)).all()
    assert (np.abs(estimate.theta_e) <= np.pi * (1 + 1e-6)).all()
    assert (np.abs(estimate.theta_e_tracked) <= np.pi * (1 + 1e-6)).all()
