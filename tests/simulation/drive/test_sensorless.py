"""Drives without an encoder: start at an unknown angle, load, reversal, loss of position."""

from __future__ import annotations

import numpy as np
import pytest

from fluxobs.machines import example
from fluxobs.simulation.drive import Course, Profile, rating, sensorless_drive, simulate
from support.records import wrapped_degrees

MACHINE, RATED = example("pmsm-2kw2"), rating("pmsm-2kw2")
BIASES = {"offset": (0.13, 0.18), "noise": 0.02}


def course(speed, load=((0.0, 0.0),), **options):
    options.setdefault("voltage_offset", (2.2, 0.0))
    return Course(
        Profile([t for t, _ in speed], [x * RATED.speed_e / MACHINE.n_p for _, x in speed]),
        RATED.dc_link,
        Profile([t for t, _ in load], [x * RATED.torque for _, x in load]),
        **options,
    )


def position_error(run):
    return wrapped_degrees(run.trace.reading.theta_e - run.trace.theta_e)


def times(run, what):
    return [event.at for event in run.events if event.what == what]


@pytest.fixture(scope="module")
def drive():
    return sensorless_drive(MACHINE, RATED, **BIASES)


@pytest.mark.parametrize("theta", [0.0, 1.6, 3.1, -2.0])
def test_start_from_standstill_then_full_load(drive, theta):
    run = simulate(
        drive,
        course(((0, 0), (0.2, 0), (0.8, 0.4)), ((1.0, 0), (1.0, 1)), theta_e=theta),
        1.5,
        seed=3,
    )
    assert len(times(run, "observer in the loop")) == 1
    assert not times(run, "position lost")
    error = position_error(run)[run.trace.mode == 1]
    assert np.sqrt(np.mean(error**2)) < 0.12
    assert np.abs(error).max() < 2.0
    assert run.trace.speed[-1] * MACHINE.n_p / RATED.speed_e == pytest.approx(0.4, abs=0.01)


def test_reversal_under_load_without_losing_the_position(drive):
    speed = ((0, 0), (0.2, 0), (0.7, 0.3), (1.1, 0.3), (1.4, -0.3))
    run = simulate(drive, course(speed, ((0.9, 0), (0.9, 0.5)), theta_e=1.0), 1.5, seed=1)
    assert not times(run, "position lost")
    after = run.t > 1.0
    assert np.abs(position_error(run)[after]).max() < 1.0
    assert run.trace.speed[-1] * MACHINE.n_p / RATED.speed_e == pytest.approx(-0.3, abs=0.03)


def test_hand_over_waits_for_a_small_standard_deviation(drive):
    """The hand-over never happens with a standard deviation above five degrees or a wrong angle."""
    for seed in range(3):
        run = simulate(drive, course(((0, 0), (0.2, 0), (0.7, 0.3)), theta_e=2.0 * seed), 1.5, seed)
        (at,) = times(run, "observer in the loop")
        k = round(at / RATED.sample_time)
        before = slice(k - 100, k + 1)
        assert (run.trace.reading.theta_e_std[before] < np.radians(5)).all()
        assert np.abs(position_error(run)[k]) < 5.0


@pytest.mark.parametrize(
    ("load", "duration"),
    [(0.5, 1.5), *(pytest.param(load, 4.0, marks=pytest.mark.slow) for load in (0.0, 0.5))],
)
def test_loss_of_position_at_standstill_is_reported(drive, load, duration):
    """In a long stop, the position is unidentifiable; the drive reports this before an error."""
    speed = ((0, 0), (0.2, 0), (0.7, 0.3), (0.9, 0.3), (1.1, 0.0))
    run = simulate(drive, course(speed, ((0.8, 0), (0.8, load)), theta_e=1.0), duration, seed=1)
    lost = times(run, "position lost")
    assert len(lost) == 1
    assert 1.1 < lost[0] < 1.6
    k = round(lost[0] / RATED.sample_time)
    std = np.degrees(run.trace.reading.theta_e_std)
    assert run.trace.mode[k] == 0
    # In the loop, errors agree with the standard deviation; positions are valid only in motion.
    running = run.trace.mode == 1
    assert (np.abs(position_error(run))[running] < 3 * std[running] + 2.0).all()
    assert np.abs(position_error(run)[running]).max() < 10.0
    valid = run.trace.reading.valid
    assert not valid[(run.t > 1.2) & (run.t < lost[0])].any()
    assert np.abs(position_error(run)[valid]).max() < 5.0


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_loss_is_reported_with_a_wrong_resistance_at_a_stop_under_load(factor):
    """The drive does not run for long without a valid position, which limits the error.

    The wrong resistive drop is perpendicular to the flux, so neither residual nor length shows it.
    """
    wrong = MACHINE.model_copy(update={"R_s": factor * MACHINE.R_s})
    drive = sensorless_drive(MACHINE, RATED, believed=wrong, noise=0.02)
    speed = ((0, 0), (0.2, 0), (0.7, 0.3), (0.9, 0.3), (1.1, 0.0))
    options = {"voltage_offset": (0.0, 0.0), "theta_e": 1.0}
    run = simulate(drive, course(speed, ((0.8, 0), (0.8, 0.5)), **options), 2.0, seed=1)
    assert times(run, "position lost")
    k = round(times(run, "position lost")[-1] / RATED.sample_time)
    assert run.trace.mode[k] == 0
    running = run.trace.mode == 1
    assert np.abs(position_error(run)[running]).max() < 60.0
    assert not run.trace.reading.valid[k - 100 : k].any()


@pytest.mark.slow
def test_a_jump_of_the_voltage_offset_does_not_stop_the_drive(drive):
    offset = Profile([0, 1.2, 1.2], [(2.2, 0.0), (2.2, 0.0), (-2.2, 0.0)])
    run = simulate(
        drive,
        course(((0, 0), (0.2, 0), (0.8, 0.4)), ((1.0, 0), (1.0, 1)), voltage_offset=offset),
        2.0,
        seed=2,
    )
    assert not times(run, "position lost")
    error = np.abs(position_error(run))
    assert error[run.t > 1.2].max() < 15.0
    assert np.sqrt(np.mean(error[run.t > 1.7] ** 2)) < 0.12


@pytest.mark.parametrize(
    ("step", "duration"), [(1.0, 1.5), pytest.param(3.0, 4.0, marks=pytest.mark.slow)]
)
def test_one_percent_of_rated_speed_with_full_load_step(step, duration):
    # At 1 % the EMF is 2.6 V: voltage errors other than offsets must be far smaller.
    slow = sensorless_drive(
        MACHINE, RATED, memory=0.67, speed_bandwidth=50.0, drift_prior=0.25, **BIASES
    )
    speed = ((0, 0), (0.2, 0), (0.3, 0.01))
    run = simulate(slow, course(speed, ((step, 0), (step, 1)), theta_e=2.0), duration)
    assert not times(run, "position lost")
    running = run.trace.mode == 1
    assert running[run.t > 2 / 3 * step].all()
    assert np.sqrt(np.mean(position_error(run)[running] ** 2)) < 0.3
    assert run.trace.speed[-1] * MACHINE.n_p / RATED.speed_e == pytest.approx(0.01, abs=0.002)


def test_same_seed_same_run(drive):
    first, second = (
        simulate(drive, course(((0, 0), (0.2, 0), (0.4, 0.2))), 0.5, seed=9) for _ in range(2)
    )
    assert (first.trace.current == second.trace.current).all()
    assert (first.trace.mode == second.trace.mode).all()
