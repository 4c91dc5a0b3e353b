"""Accuracy of the observers on closed-form records of several machines."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fluxobs import InteriorPMSM, LeastSquaresObserver, SurfacePMSM
from support.records import CURRENTS, MACHINES, SERVO, steady, vectors, wrapped_degrees

MAGNETS = [name for name in MACHINES if name != "synrm-6kw7"]


def observer_for(machine, sample_time, **options):
    """Return the observer without a flux map.

    i_d is constant in these records; with a map, a current bias acts as a wrong i_d
    (tests/observers/test_maps.py).
    """
    observer = LeastSquaresObserver.for_machine(machine, sample_time=sample_time, **options)
    return replace(observer, flux_map=None)


@pytest.mark.parametrize("per_period", [8, 12, 40])
@pytest.mark.parametrize("bias", [0.01, 0.1])
@pytest.mark.parametrize("name", MAGNETS)
def test_exact_without_noise_from_volt_seconds(name, bias, per_period):
    """With biases up to a tenth of the ratings, the error after five memories is 1e-6 rad."""
    machine, h = MACHINES[name], 2e-4
    speed = 2 * np.pi / (per_period * h)
    rated_voltage = speed * machine.psi_f
    samples = steady(
        machine,
        h,
        speed,
        1500,
        CURRENTS[name],
        bias * machine.rated_current * (0.6 + 0.8j),
        bias * rated_voltage * (0.8 - 0.6j),
    )
    estimate = observer_for(machine, h).run(
        volt_seconds=samples.volt_seconds, current=samples.current
    )
    error = np.abs(np.radians(wrapped_degrees(estimate.theta_e - samples.theta)))
    assert error[int(5 * 0.03 / h) :].max() < 1e-6
    np.testing.assert_allclose(
        estimate.drift[-1], samples.drift, atol=1e-5 * np.abs(samples.drift).max()
    )


@settings(max_examples=40)
@given(
    R_s=st.floats(0.01, 5),
    L=st.floats(0.05, 0.4),
    psi=st.floats(1e-3, 1.0),
    per_period=st.floats(8, 60),
    load=st.floats(-1, 1),
    theta0=st.floats(-3, 3),
    backwards=st.booleans(),
    salient=st.booleans(),
)
def test_random_machines(R_s, L, psi, per_period, load, theta0, backwards, salient):
    """Inductance and resistance are per-unit; direction and initial angle are arbitrary."""
    h, rated = 1e-4, 10.0
    speed = 2 * np.pi / (per_period * h) * (-1 if backwards else 1)
    L_s = L * psi / rated
    R_s = R_s * 0.05 * abs(speed) * psi / rated
    common = {"R_s": R_s, "n_p": 3, "psi_f": psi, "rated_current": rated}
    machine = (
        InteriorPMSM(L_d=0.6 * L_s, L_q=L_s, **common)
        if salient
        else SurfacePMSM(L_s=L_s, **common)
    )
    samples = steady(
        machine, h, speed, 2000, 1j * rated * load, 0.2, 0.05j * rated * R_s, theta0=theta0
    )
    estimate = observer_for(machine, h).run(
        volt_seconds=samples.volt_seconds, current=samples.current
    )
    error = np.abs(wrapped_degrees(estimate.theta_e - samples.theta))
    assert error[1500:].max() < 1e-4
    assert estimate.valid[1500:].all()
    assert estimate.speed_e[-1] == pytest.approx(speed, rel=1e-4)


def test_quadrature_of_the_current():
    """Mean currents come from 12 samples per period; half of the voltage is the resistive drop."""
    h = 2e-4
    speed = 2 * np.pi / (12 * h)
    machine = SurfacePMSM(R_s=1.3, L_s=2e-4, n_p=4, psi_f=0.01, rated_current=10)
    samples = steady(machine, h, speed, 2000, 2 + 10j)
    estimate = observer_for(machine, h, held=False).run(samples.voltage, samples.current)
    error = np.abs(wrapped_degrees(estimate.theta_e - samples.theta))[-500:]
    # The error of ∫i is 2.3 % with the trapezoid, 0.2 % with the cubic. The angle's error is R i/(ω
    # ψ) times this error.
    drop = machine.R_s * abs(2 + 10j) / (speed * machine.psi_f)
    assert drop > 0.4
    assert error.max() < 0.05


@pytest.mark.parametrize("name", MAGNETS)
def test_noise_floor_of_a_raw_angle(name):
    machine, h = MACHINES[name], 1e-4
    noise, speed = 0.005 * machine.rated_current, 600.0
    ratios = []
    for seed in range(5):
        samples = steady(
            machine, h, speed, 3000, CURRENTS[name], 0.1, 0.1, noise, theta0=seed, seed=seed
        )
        estimate = observer_for(machine, h, current_noise=noise).run(
            samples.voltage, samples.current
        )
        error = wrapped_degrees(estimate.theta_e - samples.theta)
        start = int(2 * 2 * np.pi / speed / h)  # two electrical periods
        floor = np.degrees(machine.position_inductance * noise / machine.psi_f)
        ratios.append(np.sqrt(np.mean(error[start:] ** 2)) / floor)
        assert estimate.valid[start:].all()
        # The stated standard deviation agrees.
        stated_std = np.degrees(np.median(estimate.theta_e_std[start:]))
        assert 0.8 < stated_std / np.sqrt(np.mean(error[start:] ** 2)) < 1.5
    assert np.sqrt(np.mean(np.square(ratios))) < 1.3


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_wrong_magnet_flux_does_no_harm(factor):
    h, noise = 1e-4, 0.05
    samples = steady(SERVO, h, 400.0, 4000, 6j, 0.1, 0.1, noise)
    correct = observer_for(SERVO, h, current_noise=noise).run(samples.voltage, samples.current)
    mistaken = SERVO.model_copy(update={"psi_f": factor * SERVO.psi_f})
    estimate = observer_for(mistaken, h, current_noise=noise).run(samples.voltage, samples.current)
    settled = slice(1500, None)
    difference = wrapped_degrees(estimate.theta_e - correct.theta_e)[settled]
    assert np.abs(difference).max() < 1e-3
    np.testing.assert_allclose(estimate.psi_f[settled], correct.psi_f[settled], rtol=1e-4)
    assert estimate.valid[500:].all()


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=() if n in ("servo-400w", "synrm-6kw7") else pytest.mark.slow)
        for n in MACHINES
    ],
)
def test_never_valid_at_standstill_but_after_one_period_of_motion(name):
    """After ten noisy minutes with offsets at rest, the machine turns by one electrical period."""
    machine, h, rest_rows = MACHINES[name], 2e-4, 3_000_000
    noise, speed = 0.005 * machine.rated_current, 250.0
    rows = np.r_[np.zeros(rest_rows), np.full(3000, speed)]
    samples = steady(
        machine, h, rows, len(rows), CURRENTS[name], 0.02 * machine.rated_current, 0.1, noise
    )
    estimate = observer_for(machine, h, current_noise=noise).run(samples.voltage, samples.current)
    assert not estimate.valid[:rest_rows].any()
    assert np.isfinite(estimate.theta_e).all()
    error = wrapped_degrees(estimate.theta_e - samples.theta)
    if machine.half_turn_ambiguous:
        error = wrapped_degrees(2 * np.radians(error)) / 2
    period = rest_rows + int(2 * np.pi / speed / h)
    assert estimate.valid[period:].all()
    assert np.abs(error[estimate.valid]).max() < 15


def test_carried_through_a_short_standstill():
    """After a stop and a start within milliseconds, flux and drift remain, but valid is false."""
    h = 1e-4
    speed = np.r_[np.full(3000, 500.0), np.zeros(2000), np.full(2000, 500.0)]
    samples = steady(SERVO, h, speed, len(speed), 6j, 0.1, 0.1, 0.03)
    estimate = observer_for(SERVO, h, current_noise=0.03).run(samples.voltage, samples.current)
    error = np.abs(wrapped_degrees(estimate.theta_e - samples.theta))
    assert error[2000:5000].max() < 15  # throughout the stop
    assert not estimate.valid[3500:5000].any()
    # The standard deviation grows, and stays consistent with the error.
    assert estimate.theta_e_std[4999] > 3 * estimate.theta_e_std[2999]
    assert error[4999] < 4 * np.degrees(estimate.theta_e_std[4999])
    drift_error = estimate.drift[4999] - samples.drift
    assert np.abs(drift_error).max() < 0.05 * np.abs(samples.drift).max()
    assert error[estimate.valid].max() < 15


@pytest.mark.parametrize("volts", [0.04, 0.08, 0.16])
def test_a_stop_with_a_voltage_error_is_not_valid_and_wrong(volts):
    """At rest, an inverter's error turns the flux without a residual."""
    h = 1e-4
    speed = np.interp(np.arange(10_000) * h, [0.3, 0.4], [375.0, 0.0])
    samples = steady(SERVO, h, speed, len(speed), -6j, noise=0.024, theta0=1.1)
    i = samples.current
    phases = i @ np.array([[1, -0.5, -0.5], [0, np.sqrt(0.75), -np.sqrt(0.75)]])
    signs = np.tanh(phases / 0.25)
    drop = signs @ np.array([[2 / 3, 0], [-1 / 3, np.sqrt(1 / 3)], [-1 / 3, -np.sqrt(1 / 3)]])
    estimate = observer_for(SERVO, h, current_noise=0.024).run(samples.voltage + volts * drop, i)
    error = np.abs(wrapped_degrees(estimate.theta_e - samples.theta))
    assert estimate.valid[1000:3000].all()
    assert error[estimate.valid].max() < 15
    assert not estimate.valid[4500:].any()


@pytest.mark.parametrize("name", MACHINES)
@pytest.mark.parametrize("factor", [2, 5])
def test_more_noise_than_assumed_is_noticed(name, factor):
    """The noise is several times the assumed noise, at standstill and then in motion."""
    machine, h, rest_rows = MACHINES[name], 2e-4, 50_000
    noise = 0.002 * machine.rated_current
    speed = np.r_[np.zeros(rest_rows), np.full(3000, 250.0)]
    samples = steady(machine, h, speed, len(speed), CURRENTS[name], noise=factor * noise)
    estimate = observer_for(machine, h, current_noise=noise).run(samples.voltage, samples.current)
    error = wrapped_degrees(estimate.theta_e - samples.theta)
    if machine.half_turn_ambiguous:
        error = wrapped_degrees(2 * np.radians(error)) / 2
    assert not estimate.valid[:rest_rows].any()
    assert estimate.valid[-1000:].all()
    assert np.abs(error[estimate.valid]).max() < 15
    stated_std = np.degrees(estimate.theta_e_std[-2000:])
    assert (np.abs(error[-2000:]) < 2 * stated_std).mean() > 0.9


def test_single_precision_is_enough():
    h = 5e-4
    speed = 300 + 200 * np.sin(np.arange(200_000) * h)  # 100 s
    samples = steady(SERVO, h, speed, len(speed), 6j, 0.1, 0.1, 0.02)
    double, single = (
        observer_for(SERVO, h, precision=p).run(samples.voltage, samples.current)
        for p in ("double", "single")
    )
    difference = np.abs(single.flux - double.flux)[1000:].max()
    assert difference < 1e-4 * np.median(double.psi_f)


def test_drift_jump_is_followed():
    """The bias jumps during operation by far more than its prior."""
    h = 1e-4
    samples = steady(SERVO, h, 500.0, 8000, 6j, 0.1, 0.0, 0.02)
    voltage = samples.voltage.copy()
    voltage[4000:] += [0.8, -0.5]
    estimate = observer_for(SERVO, h, current_noise=0.02).run(voltage, samples.current)
    error = np.abs(wrapped_degrees(estimate.theta_e - samples.theta))
    assert error[-1500:].max() < 2
    assert estimate.valid[-1500:].all()
    np.testing.assert_allclose(estimate.drift[-1], samples.drift - [0.8, -0.5], atol=0.02)


def test_missing_scales_are_named():
    bare = SurfacePMSM(R_s=1, L_s=1e-3, n_p=2)
    with pytest.raises(ValueError, match=r"rated_current is missing.*for_machine"):
        observer_for(bare, 1e-4)
    with pytest.raises(ValueError, match=r"psi_f is missing.*for_machine"):
        observer_for(bare, 1e-4, rated_current=5.0)
    assert observer_for(bare, 1e-4, rated_current=5.0, psi_f=0.1).flux_base == 0.1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"memory": 5e-4}, "memory must be at least ten samples, 0.001 s here"),
        ({"drift_prior": 0.0}, "drift_prior must be positive"),
        ({"current_noise": np.nan}, "current_noise must be positive and finite"),
        ({"precision": "half"}, "precision"),
    ],
)
def test_unusable_settings_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        observer_for(SERVO, 1e-4, **options)


@pytest.mark.parametrize("error", [0.05, 0.1, 0.15, 0.25])
@pytest.mark.parametrize("frequency", [2.2, 2.6, 3.0, 4.0])
def test_a_locked_rotor_under_a_turning_current_is_not_called_valid(error, frequency):
    """With a wrong R, the current alone imitates half a turn of the locked rotor."""
    machine = MACHINES["servo-400w"]
    h, rows, theta = 1e-4, 60_000, 0.7
    turn = np.exp(2j * np.pi * frequency * h * np.arange(rows))
    noise = np.random.default_rng(1).standard_normal((2, rows))
    i = 8 * turn + 0.0024 * (noise[0] + 1j * noise[1])
    u = 8 * turn * (1.0 + error) * machine.R_s + machine.L_s * 8 * turn * 2j * np.pi * frequency
    observer = LeastSquaresObserver.for_machine(machine, sample_time=h)
    estimate = observer.run(vectors(u), vectors(i))
    wrong = estimate.valid & (np.abs(wrapped_degrees(estimate.theta_e - theta)) > 15)
    assert not wrong.any()


@pytest.mark.parametrize(
    ("swing", "frequency", "memory"), [(200.0, 100.0, 0.03), (60.0, 25.0, 0.1)]
)
def test_a_position_is_valid_despite_speed_ripple(swing, frequency, memory):
    machine = MACHINES["servo-400w"]
    t = 1e-4 * np.arange(10_000)
    speed = 3 * swing + swing * np.cos(2 * np.pi * frequency * t)
    data = steady(machine, 1e-4, speed, len(t), noise=0.01)
    observer = LeastSquaresObserver.for_machine(machine, sample_time=1e-4, memory=memory)
    estimate = observer.run(data.voltage, data.current)
    assert estimate.valid[-2000:].all()
    assert np.abs(wrapped_degrees(estimate.theta_e - data.theta))[-2000:].max() < 1


@pytest.mark.parametrize("missing", ["voltage", "current"])
@pytest.mark.parametrize("speed", [1700.0, 4000.0])  # 37 and 16 samples per period
def test_missing_samples_leave_no_wrong_position(missing, speed):
    machine = MACHINES["servo-400w"]
    data = steady(machine, 1e-4, speed, 6000, i_dq=12j, noise=0.02)
    u, i = data.voltage.copy(), data.current.copy()
    for count in (1, 2, 3):
        (u if missing == "voltage" else i)[2000 * count - 1000 :][:count] = np.nan
    observer = LeastSquaresObserver.for_machine(machine, sample_time=1e-4)
    estimate = observer.run(u, i)
    unmeasured = ~(np.isfinite(u).all(axis=1) & np.isfinite(i).all(axis=1))
    assert not estimate.valid[unmeasured].any()
    assert estimate.valid[1000:][~unmeasured[1000:]].all()
    error = np.abs(wrapped_degrees(estimate.theta_e - data.theta))
    assert error[estimate.valid].max() < 2
