"""The estimate of every row: sensitivities by running again, jumps, standstill, coverage."""

from dataclasses import replace

import numpy as np
import pytest

import fluxobs
from fluxobs.comparison.bound import Unknowns, two_sided_bound
from fluxobs.estimation.course import Learning, course_of
from fluxobs.logs.scales import Scales
from fluxobs.machines.model.frames import wrap
from fluxobs.smoothing.assumptions import ITEMS, NAMES
from fluxobs.smoothing.record import (
    QUANTITIES,
    SHARES,
    Assumed,
    RecordSamples,
    SmoothingModel,
    smooth_record,
)
from support.assumed import alone
from support.records import PMSM, SERVO, course, driven, log_columns

H = 1e-4
T = np.arange(8000) * H
#: Run-up with two loads, and a reversal at the end.
SPEED = np.interp(T, [0.0, 0.2, 0.4, 0.6, 0.8], [200.0, 200.0, 600.0, 600.0, -300.0])
CURRENT = 1j * np.interp(T, [0.0, 0.1, 0.15, 0.5, 0.55], [2.0, 2.0, 8.0, 8.0, -4.0])
SCALES = Scales(
    current=6.0, voltage=8.0, current_noise=0.02, voltage_noise=0.1, current_speed=500.0
)


@pytest.fixture(scope="module")
def samples():
    return driven(SERVO, H, SPEED, CURRENT, noise=0.02)


@pytest.fixture(scope="module")
def model():
    return SmoothingModel.of(SERVO, SCALES, H, SERVO.psi_f, 0.02, 600.0, {})


@pytest.fixture(scope="module")
def record(samples):
    angle = np.unwrap(samples.theta)
    voltage = samples.voltage.copy()
    voltage[0] = voltage[1]
    return RecordSamples(
        voltage,
        samples.current,
        np.zeros(len(angle), int),
        angle,
        np.full(len(angle), 0.02),
    )


def by_block(model, values):
    m = model.rows_per_block
    return values[: len(values) // m * m].reshape(-1, m).mean(axis=1)


def run_again(model, record, name):
    """Return the shares of one assumption, and the changes of the outputs if it is moved."""
    start = alone(model, name)
    shares = smooth_record(model, record, start, learning=False).shares[..., SHARES.index(name)]
    step = 0.02 * model.stds[name]
    ends = [
        smooth_record(
            model, record, start.with_deviation(name, sign * step), learning=False
        ).outputs
        for sign in (1, -1)
    ]
    scale = model.stds[name] / step / 2
    moved = {key: scale * (ends[0][key] - ends[1][key]) for key in ("torque", "speed_e")}
    moved["flux"] = np.hypot(
        *(scale * (ends[0][key] - ends[1][key]) for key in ("flux_alpha", "flux_beta"))
    ) / np.sqrt(2)
    moved["theta_e"] = scale * wrap(ends[0]["theta_e"] - ends[1]["theta_e"])
    blocks = {key: by_block(model, value) for key, value in moved.items()}
    turning = np.abs(by_block(model, SPEED)) > 100  # at rest nothing is linear
    turning[-2:] = False  # the last block has fewer rows behind it
    return shares, blocks, turning


@pytest.mark.parametrize(
    "name",
    [
        *("resistance", "inverter_soft", "lag", "delay", "offset_alpha", "current_gain_re"),
        *("voltage_gain_im", "iron_loss", "L_d", "psi_f", "fifth", "seventh"),
    ],
)
def test_a_share_is_what_running_again_gives(model, record, name):
    shares, blocks, turning = run_again(model, record, name)
    # The smoother cancels most of an offset; what remains is known to 0.15°.
    # A block's flux is that of its end.
    least = {"theta_e": 2.5e-3, "flux": 2e-2 * SERVO.psi_f, "torque": 2e-2 * SERVO.psi_f * 8}
    for quantity, smallest in least.items():
        share = np.sqrt(shares[:, QUANTITIES.index(quantity)])
        size = np.sqrt(np.mean(blocks[quantity] ** 2))
        np.testing.assert_allclose(
            share[turning],
            np.abs(blocks[quantity][: len(share)][turning]),
            atol=0.05 * size + smallest,
            err_msg=quantity,
        )


def test_the_budget_of_the_speed_is_what_running_again_gives(model, record):
    """Harmonics and unequal gains modulate the speed."""
    for name in ("fifth", "current_gain_re"):
        shares, blocks, turning = run_again(model, record, name)
        share = shares[:, QUANTITIES.index("speed_e")][turning]
        moved = blocks["speed_e"][: len(shares)][turning]
        assert np.sqrt(share.mean()) == pytest.approx(np.sqrt(np.mean(moved**2)), rel=0.3)


def test_assumptions_of_the_items_are_those_of_the_c_code():
    listed = [name for item in ITEMS for name in item.assumptions]
    assert sorted(listed) == sorted(NAMES)


def test_two_standard_deviations_hold(samples):
    result = fluxobs.estimate(log_columns(samples), SERVO)
    error = np.abs(wrap(result["theta_e"] - samples.theta))
    assert (error < 2 * result["theta_e_std"]).mean() > 0.95
    assert np.sqrt(np.mean(error**2)) < np.radians(1)
    speed_error = np.abs(result["speed_e"] - SPEED)
    assert (speed_error < 3 * result["speed_e_std"])[30:-30].mean() > 0.95


def test_a_start_at_rest_is_known_from_behind():
    speed = np.interp(T, [0.1, 0.3], [0.0, 500.0])
    samples = driven(SERVO, H, speed, np.full(len(T), 2j), noise=0.02)
    result = fluxobs.estimate(log_columns(samples), SERVO)
    error = np.abs(wrap(result["theta_e"] - samples.theta))
    assert result["valid"][1000:].all()
    assert (error < 3 * result["theta_e_std"]).all()
    causal = fluxobs.estimate(log_columns(samples), SERVO, causal=True)
    assert causal["valid"].sum() < result["valid"].sum()


def test_a_stretch_that_does_not_fit_is_not_valid(samples):
    voltage = samples.voltage.copy()
    voltage[4000:4060] = 0.0  # the bridge was off, and the log does not tell the voltage
    result = fluxobs.estimate(log_columns(replace(samples, voltage=voltage)), SERVO)
    error = np.abs(wrap(result["theta_e"] - samples.theta))
    valid = result["valid"]
    assert not valid[4005:4055].any()
    assert valid[:3500].mean() > 0.9
    assert valid[4600:].mean() > 0.8
    assert error[valid].max() < np.radians(5)
    start, end = result.budget.stretches[0]
    assert start < 4000 * H
    assert 4060 * H < end < 4600 * H
    assert result.budget.stretches[-1][1] < 5600 * H
    assert any(text.startswith("These stretches contradict") for text in result.warnings)


def test_a_rotor_that_never_turns_is_not_known():
    samples = driven(SERVO, H, np.zeros(len(T)), CURRENT, noise=0.02)
    result = fluxobs.estimate(log_columns(samples), SERVO)
    assert not result["valid"].any()


def test_learnt_parameters_hold():
    samples = course(R_s=1.3 * PMSM.R_s)
    result = fluxobs.estimate(log_columns(samples), PMSM, lag=0)
    learnt = result.learnt
    assert abs(learnt.resistance - 1.3 * PMSM.R_s) < 3 * learnt.resistance_std
    assert learnt.resistance_std < 0.1 * PMSM.R_s  # the sag of the DC link looks alike
    assert result.budget.std < np.radians(3)
    assert "° instead of " in result.budget.advice


def test_segments_are_joined_like_one_record(model):
    """Without a walk, the joined estimate is the weighted mean, with the prior counted once."""
    still = model.with_numbers(psi_rate=0.0, resistance_rate=0.0)
    prior = np.array([still.stds[name] ** 2 for name in still.active])
    rng = np.random.default_rng(1)
    parts, total, moment = [], 1 / prior, np.zeros(len(prior))
    for n in range(3):
        information = rng.uniform(0.5, 20, len(prior)) / prior
        value = rng.normal(0, 1, len(prior)) * np.sqrt(prior)
        covariance = 1 / (information + 1 / prior)
        deviations = dict.fromkeys(NAMES, 0.0) | dict(
            zip(still.active, covariance * information * value, strict=True)
        )
        parts.append(Learning(float(n), Assumed(deviations, np.diag(covariance), 1.0), 0.01))
        total, moment = total + information, moment + information * value
    joined = course_of(still, parts)
    for n in range(3):
        np.testing.assert_allclose(joined.values[n], moment / total)
        np.testing.assert_allclose(np.diag(joined.covariances[n]), 1 / total)
    bad = replace(parts[0], misfit=10.0)
    np.testing.assert_allclose(
        course_of(still, [bad, parts[1]]).values[0],
        [parts[1].assumed.deviations[name] for name in still.active],
    )


def test_the_right_model_is_at_the_bound():
    """Only white noise of the current: the error is that of the Cramér–Rao bound of all samples."""
    exact = dict.fromkeys(
        [
            *("resistance", "inverter", "lag", "offset", "current_gain", "voltage_gain"),
            *("iron_loss", "L_d", "psi_f", "harmonics"),
        ],
        0.0,
    )
    squares = []
    for seed in range(3):
        samples = driven(SERVO, H, SPEED, CURRENT, noise=0.02, seed=seed)
        result = fluxobs.estimate(log_columns(samples), SERVO, lag=0, priors=exact)
        squares.append(wrap(result["theta_e"] - samples.theta) ** 2)
    i = CURRENT * np.exp(1j * samples.theta)
    drift = 0.02 * SERVO.rated_current * SERVO.R_s
    bound = two_sided_bound(
        SERVO, samples.theta, np.stack([i.real, i.imag], axis=1), H, Unknowns(0.02, drift)
    )
    assert 0.97 < np.sqrt(np.mean(squares) / np.mean(bound**2)) < 1.05


def test_magnets_that_weaken_do_not_change_the_rows_before():
    """A quarter of the magnet flux is lost within 5 ms: both sides keep their own flux."""
    rows, parts = 20_000, 8
    t = H / parts * np.arange(rows * parts)
    speed = np.interp(t, [0, 0.3, 0.8, 1.1, 2], [200, 500, 500, 800, 600])
    load = np.interp(t, [0, 0.2, 0.21, 0.7, 0.71, 1.5, 1.51, 2], [2, 2, 8, 8, 3, 3, 9, 9])
    psi = SERVO.psi_f * (1 - 0.25 * np.clip((t - 1.2) / 0.005, 0, 1))
    turned = np.exp(1j * np.cumsum(speed) * H / parts)
    i = 1j * load * turned
    u = SERVO.R_s * i + np.gradient(SERVO.L_s * i + psi * turned, t)
    rng = np.random.default_rng(0)
    noise = 0.02 * (rng.standard_normal(rows) + 1j * rng.standard_normal(rows))
    result = fluxobs.estimate(
        (u.reshape(rows, parts).mean(axis=1), i[::parts] + noise), SERVO, sample_time=H, lag=0
    )
    error = np.abs(wrap(result["theta_e"] - np.angle(turned[::parts])))
    valid = result["valid"]
    assert valid[:11_000].mean() > 0.95
    assert np.degrees(error[valid].max()) < 3
    ((start, end),) = result.budget.stretches
    assert 1.1 < start < 1.2 < end < 1.3
    assert result["psi_f"][11_000] == pytest.approx(SERVO.psi_f, rel=0.01)
    assert result["psi_f"][-1000] == pytest.approx(0.75 * SERVO.psi_f, rel=0.01)
