"""Voltages held over a sample, and the memory for a short L/R."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

import fluxobs
from fluxobs import AdaptiveObserver, LeastSquaresObserver, ObserverError
from fluxobs.machines import SurfacePMSM, example
from fluxobs.machines.model.held import CUBIC, kink_weights, mean_current, without_kinks
from support.records import held, wrapped_degrees

#: A motor of a multirotor with R h/L = 0.25, and its speed at 14 samples per period.
H = 1e-4
DRONE = example("drone-900kv")
SPEED = 2 * np.pi / (14 * H)
AT_SPEED = DRONE.with_values(rated_speed=SPEED / DRONE.n_p)


def load(t):
    return np.where((t > 0.25) & (t < 0.4), 20.0, 8.0)


def record(noise=0.0, seed=0):
    return held(DRONE, H, SPEED, load, 0.5, 0.1 + 0.05j, 0.02, noise, seed=seed)


def errors(observer, samples):
    estimate = observer.run(samples.voltage, samples.current)
    return wrapped_degrees(estimate.theta_e - samples.theta), estimate


@pytest.mark.parametrize("share", [1e-4, 0.005, 0.0099, 0.0101, 0.1, 0.25, 1.0, 3.0, 20.0, 50.0])
def test_weights_are_the_error_of_the_cubic(share):
    def response(t):
        return 1 - np.exp(-share * t)

    for intervals_ago, weight in enumerate(kink_weights(share)):
        samples = [response(intervals_ago + 1 - k) if k <= intervals_ago else 0.0 for k in range(4)]
        cubic = np.dot(CUBIC, samples) / 24
        exact = quad(response, intervals_ago, intervals_ago + 1)[0]
        assert weight == pytest.approx(exact - cubic, rel=0.01 if share < 0.01 else 1e-9)


def test_the_mean_of_a_cubic_is_exact():
    t = np.arange(8.0)
    mean = (t**4 - (t - 1) ** 4) / 4
    np.testing.assert_allclose(mean_current(t**3)[3:], mean[3:], atol=1e-12)
    np.testing.assert_array_equal(mean_current(np.stack([t**3, t]), axis=1)[0], mean_current(t**3))


@pytest.mark.parametrize("axis", [0, 1])
def test_a_missing_voltage_affects_no_other(axis):
    u = np.random.default_rng(0).standard_normal((9, 2))
    u[4, 1] = np.nan
    smoothed = without_kinks(u if axis == 0 else u.T, 0.25, axis=axis)
    smoothed = smoothed if axis == 0 else smoothed.T
    assert np.isnan(smoothed).sum() == 1
    now, before = kink_weights(0.25)
    expected = u[2] - now * (u[2] - u[1]) - before * (u[1] - u[0])
    np.testing.assert_allclose(smoothed[2], expected, atol=1e-12)


@pytest.mark.parametrize("kind", [LeastSquaresObserver, AdaptiveObserver])
@pytest.mark.parametrize("precision", ["double", "single"])
def test_held_voltages(kind, precision):
    """Required: 0.1 degrees; with the cubic alone, the error is 0.6 degrees."""
    samples = record()
    error, estimate = errors(kind.for_machine(DRONE, sample_time=H, precision=precision), samples)
    assert np.abs(error[1500:]).max() < 0.1
    assert estimate.valid[1500:].mean() > 0.995
    error_of_cubic, _ = errors(kind.for_machine(DRONE, sample_time=H, held=False), samples)
    assert np.abs(error_of_cubic[1500:]).mean() > 0.5


def test_missing_voltages_are_bridged():
    samples = record()
    voltage = samples.voltage.copy()
    voltage[[1000, 2000, 2001]] = np.nan
    observer = LeastSquaresObserver.for_machine(DRONE, sample_time=H)
    estimate = observer.run(voltage, samples.current)
    error = wrapped_degrees(estimate.theta_e - samples.theta)
    assert np.abs(error[estimate.valid]).max() < 1.5


def test_noise_in_the_resistive_drop_stays_below_the_direct_noise():
    """Required: at most 1.5 times the floor L σ/ψ; a memory of 0.03 s gives 2.5 times."""
    noise = 0.06
    floor = np.degrees(DRONE.L_s * noise / DRONE.psi_f)
    ratios = {memory: [] for memory in (None, 0.03)}
    for seed in range(4):
        samples = record(noise, seed)
        for memory, values in ratios.items():
            observer = LeastSquaresObserver.for_machine(AT_SPEED, sample_time=H, memory=memory)
            error, _ = errors(observer, samples)
            values.append(error[1500:].std() / floor)
    assert np.mean(ratios[None]) < 1.5
    assert np.mean(ratios[0.03]) > 2.2


def test_the_memory_holds_a_turn_at_a_quarter_of_the_speed():
    assert AT_SPEED.memory_for(H) == pytest.approx(3.5 * (DRONE.L_s / DRONE.R_s) ** 2 / H)
    assert DRONE.memory_for(H, 500.0) == 0.03
    gimbal = SurfacePMSM(R_s=10.0, L_s=2e-3, n_p=7, psi_f=5e-3, rated_current=1.0)
    assert gimbal.memory_for(H) == 0.03  # its speed is unknown
    slow = gimbal.with_values(rated_speed=200.0)
    assert slow.memory_for(H) == pytest.approx(4 * 2 * np.pi / 1400)


OPTIONS = {"sample_time": H, "unknowns": "drift", "causal": True}


def test_whether_voltages_are_held_is_decided_per_log():
    samples = record(0.03)
    log = (samples.voltage, samples.current)
    results = {
        held: fluxobs.estimate(log, DRONE, lag=1.0, held=held, **OPTIONS)
        for held in (None, True, False)
    }
    assert results[None].observer.held == results[True].observer.held == pytest.approx(0.25)
    assert results[False].observer.held == 0
    half_sample_lag = fluxobs.estimate(log, DRONE, lag=0.5, **OPTIONS)
    assert half_sample_lag.observer.held == 0  # the voltage has kinks inside an interval
    assert results[None].observer.memory == pytest.approx(0.0056)  # from the speed of the log


def test_identify_includes_kinks_too():
    log = fluxobs.read_log((record(0.03).voltage, record(0.03).current), sample_time=H, lag=1.0)
    identified = fluxobs.identify(log, DRONE.with_values(R_s=0.06), free="R_s")
    assert identified.machine.R_s == pytest.approx(0.05, abs=3 * identified.parameters[0].std)


def test_an_unknown_word_for_held_is_refused():
    with pytest.raises(ObserverError, match='True, False or "auto"'):
        LeastSquaresObserver.for_machine(DRONE, sample_time=H, held="often")
