"""The score of the likelihood of a log: exact, and of mean zero at the true parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.estimates import degrees
from engine.likelihood import NAMES, ORDERS, UNKNOWNS, N, Start, likelihood
from engine.loop import INTERIOR, SURFACE, Conditions, simulated
from engine.score_table import ERRORS, with_error
from engine.scores import TESTED, parameters_of, scores_at_the_truth

#: Drives of a test, and of a test of a large error. The mean of a score is within 3.5 standard
#: errors of zero for each of 9 parameters with a probability of 0.996; its standard deviation is
#: within 3.5 of its own errors.
DRIVES, FEW, MOST = 24, 10, 3.5
SPREAD = MOST / np.sqrt(2 * DRIVES)

CONDITIONS = {
    "surface": SURFACE,
    "interior, delayed, fast controller": replace(INTERIOR, lag=1, bandwidth=0.25),
    "surface, mean of two samples": replace(SURFACE, moving_mean=2),
    "surface, loud": replace(SURFACE, noise=0.1),
    "surface, quiet": replace(SURFACE, noise=0.01),
    "surface, slow controller": replace(SURFACE, bandwidth=0.05),
    "surface, delayed": replace(SURFACE, lag=1, bandwidth=0.2),
    "interior": INTERIOR,
    "interior, quiet": replace(INTERIOR, noise=0.01),
}
QUICK = tuple(CONDITIONS)[1:3]


@pytest.mark.parametrize("conditions", [SURFACE, INTERIOR], ids=["surface", "interior"])
def test_score_is_the_derivative_of_the_objective(conditions):
    """Away from the truth, with every parameter at work."""
    record = simulated(replace(conditions, duration=0.08), 1)
    u, i = record.voltage[:, 0], record.current[:, 0].copy()
    i[300:303] = np.nan
    p = parameters_of(conditions) + 0.1
    p[[NAMES.index(name) for name in ("voltage", "drift", "gain")]] = np.log([1e-3, 0.3, 0.03])
    start = Start(float(record.angle[0, 0]), 0.1, 240.0, 30.0, 300.0, 1e-3, 0.1, 0.02, 20)
    got = likelihood(u, i, 1e-4, p, start)
    for k, name in enumerate(NAMES):
        step = 1e-5 * np.eye(N)[k]
        above, below = (likelihood(u, i, 1e-4, p + s * step, start).objective for s in (1, -1))
        assert got.score[k] == pytest.approx((above - below) / 2e-5, rel=1e-5, abs=1e-3), name


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=() if n in QUICK else pytest.mark.slow) for n in CONDITIONS],
)
def test_score_has_mean_zero_and_its_information_at_the_truth(name):
    """Whatever noise, controller, delay and machine."""
    got = scores_at_the_truth(CONDITIONS[name], DRIVES)
    for n, deviation in enumerate(got.deviation()):
        assert abs(deviation) < MOST, TESTED[n]
    for n, spread in enumerate(got.spread()):
        assert abs(spread - 1) < SPREAD, TESTED[n]


@pytest.mark.parametrize("error", ERRORS)
def test_a_deliberate_error_is_seen(tmp_path, error):
    """Noise of the current returns in the voltages of the controller: R i must not take it."""
    own = with_error(ERRORS[error], tmp_path)
    loud = replace(SURFACE, noise=0.1)
    assert np.abs(scores_at_the_truth(loud, FEW, own).deviation()).max() > 2 * MOST


def test_derivatives_by_the_harmonics_hold_the_gain():
    """Small, as a fit leaves them: the gain then depends on them in second order."""
    record = simulated(replace(INTERIOR, duration=0.08), 1)
    u, i = record.voltage[:, 0], record.current[:, 0]
    p = np.zeros(UNKNOWNS)
    p[:N] = parameters_of(INTERIOR)
    start = Start(float(record.angle[0, 0]), 0.01, 250.0, 1.0, 0.0, 1e-5, 0.05, 0.0, 20)
    rng = np.random.default_rng(0)
    p[N:-1] = 2e-7 * rng.standard_normal(2 * len(ORDERS))
    got = likelihood(u, i, 1e-4, p, start)
    stds = np.sqrt(np.diag(got.information)[N:]) ** -1
    for k in range(N, UNKNOWNS - 1):
        step = 0.01 * stds[k - N] * np.eye(UNKNOWNS)[k]
        above, below = (likelihood(u, i, 1e-4, p + s * step, start).objective for s in (1, -1))
        numeric = (above - below) / (0.02 * stds[k - N])
        assert stds[k - N] * (got.score[k] - numeric) == pytest.approx(0.0, abs=0.3), ORDERS[
            (k - N) // 2
        ]


def test_missing_rows_leave_the_angle_right():
    """Currents and voltages are missing at times."""
    record = simulated(replace(SURFACE, duration=0.2), 1)
    u, i = record.voltage[:, 0].copy(), record.current[:, 0].copy()
    u[[0, 500, 900]], i[[300, 301, 302, 700]] = np.nan, np.nan
    start = Start(float(record.angle[0, 0]), 0.1, 250.0, 10.0, 0.0, 4e-4, 0.05, 0.0, 100)
    got = likelihood(u, i, 1e-4, parameters_of(SURFACE), start)
    error = degrees(got.rows["angle"], record.angle[:, 0])
    assert np.abs(error[200:]).max() < 1.0
    assert not got.rows["measured"][[300, 301, 302, 700]].any()


def test_numbers_that_cannot_be_end_the_evaluation():
    record = simulated(replace(SURFACE, duration=0.02), 1)
    u, i = record.voltage[:, 0], record.current[:, 0]
    start = Start(0.0, 0.1, 240.0, 30.0, 0.0, 1e-3, 0.1, 0.0, 0)
    p = parameters_of(Conditions())
    p[NAMES.index("L_d")] = np.nan
    with pytest.raises(AssertionError, match="not finite"):
        likelihood(u, i, 1e-4, p, start)


def test_a_rotor_that_jumps_is_found_again():
    """A radian between two rows: with a price for it, the filter starts again and finds it."""
    record = simulated(replace(SURFACE, duration=0.3), 1)
    jump = 1.0 * (np.arange(len(record.angle)) >= 1000)
    u, i = (x[:, 0] * np.exp(1j * jump) for x in (record.voltage, record.current))
    angle = record.angle[:, 0] + jump
    lost, found = (
        likelihood(
            u,
            i,
            1e-4,
            parameters_of(SURFACE),
            Start(angle[0], 0.2, 250.0, 30.0, 300.0, 4e-4, 0.05, 0.0, 100, price),
        )
        for price in (0.0, 9.2)
    )
    assert found.losses > 0 == lost.losses
    error = degrees(found.rows["angle"], angle)
    assert np.abs(error[1400:]).max() < 2.0
    assert found.objective < lost.objective
