"""The score of the likelihood of a log: exact, and of mean zero at the true parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.estimates import degrees
from engine.likelihood import (
    INDEX,
    LINEAR,
    NAMES,
    UNKNOWNS,
    Machine,
    N,
    Start,
    all_parameters,
    course_of,
    likelihood,
    settled,
)
from engine.loop import INTERIOR, SURFACE, Conditions, simulated
from engine.score_table import ERRORS, with_error
from engine.scores import START, TESTED, parameters_of, scores_at_the_truth

#: Drives of a test, and of a test of a large error. The mean of a score is within 3.5 standard
#: errors of zero for each of 13 parameters with a probability of 0.994; its standard deviation is
#: within 3.5 of its own errors.
DRIVES, FEW, MOST = 24, 10, 3.5
SPREAD = MOST / np.sqrt(2 * DRIVES)

CONDITIONS = {
    "surface": SURFACE,
    "interior, delayed, fast controller": replace(INTERIOR, lag=1, bandwidth=0.25),
    "surface, mean of two samples": replace(SURFACE, moving_mean=2),
    "surface, loud": replace(SURFACE, noise=0.1),
    "surface, quiet": replace(SURFACE, noise=0.003),
    "surface, slow controller": replace(SURFACE, bandwidth=0.05),
    "surface, delayed": replace(SURFACE, lag=1, bandwidth=0.2),
    "interior": INTERIOR,
    "interior, quiet": replace(INTERIOR, noise=0.01),
}
QUICK = tuple(CONDITIONS)[1:3]


#: Index of the angle among the states.
ANGLE = 2
#: Parameters whose derivatives are exact about any course. The others change the transition or the
#: measurement's derivative a little, and hold the gain.
EXACT = (*NAMES[: NAMES.index("loss")], "lag", "delay", "offset_alpha", "offset_beta")


def log_with_everything(conditions: Conditions):
    """Return a log and parameters away from the truth, with every parameter at work."""
    record = simulated(replace(conditions, duration=0.08), 1)
    u, i = record.voltage[:, 0], record.current[:, 0].copy()
    i[300:303] = np.nan
    p = all_parameters(parameters_of(conditions) + 0.03)
    given = {"voltage": np.log(1e-3), "drift": np.log(0.3), "loss": np.log(0.1)}
    given |= {"mobility": 300.0, "iron_loss": 0.01, "offset_alpha": 0.02, "gain_re": 0.01}
    given |= {"range": 0.0}  # no limit
    for name, value in given.items():
        p[INDEX[name]] = value
    p[N:] = 1e-5 * np.random.default_rng(0).standard_normal(UNKNOWNS - N)
    return u, i, record.angle[:, 0], p


SATURATING = Machine(None, False, True, 12.0, 0.0)
CAGE = Machine(None, True, False, 12.0, 1e-6)


@pytest.mark.parametrize(
    ("conditions", "machine", "saturation"),
    [
        pytest.param(SURFACE, LINEAR, 0.0, id="surface"),
        pytest.param(INTERIOR, LINEAR, 0.0, id="interior"),
        pytest.param(INTERIOR, SATURATING, 0.1, id="saturating"),
        pytest.param(SURFACE, CAGE, 0.0, id="cage"),
    ],
)
def test_score_is_the_derivative_of_the_objective(conditions, machine, saturation):
    """About any course; slopes of the loss and the harmonics in the gain are held."""
    u, i, angle, p = log_with_everything(conditions)
    p[INDEX["loss"]] = np.log(1e-9)
    p[INDEX["saturation_d"]], p[INDEX["saturation_q"]] = saturation, 0.5 * saturation
    p[N:] = 0.0
    exact = set(EXACT) - (set() if saturation else {"saturation_d", "saturation_q"})
    course = course_of(i, angle + 0.02 * np.sin(np.arange(len(angle)) / 50), p)
    if machine.cage:  # without magnets
        course["psi"], p[INDEX["psi_f"]] = np.exp(p[INDEX["psi_f"]]), -np.inf
        p[INDEX["rotor_resistance"]], p[INDEX["magnetizing"]] = np.log(0.05), np.log(5e-3)
        exact -= {"L_d", "L_q", "psi_f"}
    start = Start(1e-3, 0.1, 30.0, 1e-3, 300.0, 0.1, 20)
    got = likelihood(u, i, 1e-4, p, course, start, machine=machine)
    for name in exact:
        k = INDEX[name]
        step = (1e-2 if name == "mobility" else 1e-5) * np.eye(UNKNOWNS)[k]
        above, below = (
            likelihood(u, i, 1e-4, p + s * step, course, start, machine=machine).objective
            for s in (1, -1)
        )
        numeric = (above - below) / (2 * step[k])
        assert got.score[k] == pytest.approx(numeric, rel=1e-5, abs=1e-3), name


@pytest.mark.parametrize("conditions", [SURFACE, INTERIOR], ids=["surface", "interior"])
def test_score_about_the_smoothed_course(conditions):
    """Near the truth, what is held changes the objective little: the score is right within a third
    of its standard deviation for each unknown.
    """
    record = simulated(replace(conditions, duration=0.1), 1)
    u, i = record.voltage[:, 0], record.current[:, 0]
    p = all_parameters(parameters_of(conditions))
    p[N:] = 2e-7 * np.random.default_rng(0).standard_normal(UNKNOWNS - N)
    start = Start(4e-2, 1.8, 3e2, 0.0, 1e4, 0.05, 20)
    got, course = settled(u, i, 1e-4, p, course_of(i, record.angle[:, 0], p), start)
    stds = 1 / np.sqrt(np.maximum(np.diag(got.information), 1e-12))
    for k in range(UNKNOWNS):
        if stds[k] > 100:  # the log does not tell
            continue
        size = min(0.01 * stds[k], 0.01)
        step = size * np.eye(UNKNOWNS)[k]
        above, below = (
            likelihood(u, i, 1e-4, p + s * step, course, start).objective for s in (1, -1)
        )
        numeric = (above - below) / (2 * size)
        if k in (INDEX["lag"], INDEX["delay"]):  # late and early voltages are those of other rows
            numeric = (above - got.objective) / size
        assert stds[k] * got.score[k] == pytest.approx(stds[k] * numeric, abs=0.33), k


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
    file, *changes = ERRORS[error]
    own = with_error(file, changes, tmp_path)
    loud = replace(SURFACE, noise=0.1)
    assert np.abs(scores_at_the_truth(loud, FEW, own).deviation()).max() > 2 * MOST


def test_missing_rows_leave_the_angle_right():
    """Currents and voltages are missing at times."""
    record = simulated(replace(SURFACE, duration=0.2), 1)
    u, i, p = record.voltage[:, 0].copy(), record.current[:, 0].copy(), parameters_of(SURFACE)
    u[[0, 500, 900]], i[[300, 301, 302, 700]] = np.nan, np.nan
    course = course_of(i, record.angle[:, 0] + 0.05, p)
    got, course = settled(u, i, 1e-4, p, course, START)
    error = degrees(course["angle"], record.angle[:, 0])
    assert np.abs(error).max() < 1.0
    assert not got.rows["measured"][[300, 301, 302, 700]].any()


def test_numbers_that_cannot_be_end_the_evaluation():
    record = simulated(replace(SURFACE, duration=0.02), 1)
    u, i, p = record.voltage[:, 0], record.current[:, 0], parameters_of(Conditions())
    course = course_of(i, record.angle[:, 0], p)
    p[INDEX["L_d"]] = np.nan
    with pytest.raises(AssertionError, match="not finite"):
        likelihood(u, i, 1e-4, p, course, START)


def test_the_course_settles_quadratically():
    """The course starts half a radian off; after six passes of smoothing it no longer changes."""
    record = simulated(replace(SURFACE, duration=0.2), 1)
    u, i, p = record.voltage[:, 0], record.current[:, 0], parameters_of(SURFACE)
    p[INDEX["loss"]], p[INDEX["knee"]] = np.log(0.05), np.log(0.3)
    far, near = (
        settled(u, i, 1e-4, p, course_of(i, record.angle[:, 0] + 0.5, p), START, passes=n)[1]
        for n in (6, 7)
    )
    assert np.abs(far["angle"] - near["angle"]).max() < 1e-6


def test_a_course_is_not_lost_where_the_filter_knows_nothing():
    """Nothing is measured for a while, and the filter no longer knows the angle: the smoothed angle
    before and after is right all the same.
    """
    record = simulated(replace(SURFACE, duration=0.4), 1)
    u, i, p = record.voltage[:, 0].copy(), record.current[:, 0].copy(), parameters_of(SURFACE)
    u[1000:3000], i[1000:3000] = np.nan, np.nan
    course = course_of(i, record.angle[:, 0], p)
    got, course = settled(u, i, 1e-4, p, course, START)
    error = degrees(course["angle"], record.angle[:, 0])
    assert np.abs(error[3300:]).max() < 1.0
    assert np.abs(error[:900]).max() < 1.0
    assert np.sqrt(got.rows["P"][2999, ANGLE, ANGLE]) > 0.5
