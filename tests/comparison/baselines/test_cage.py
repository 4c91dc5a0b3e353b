"""Observers of induction machines in common use."""

from __future__ import annotations

import numpy as np
import pytest

from fluxobs.comparison.baselines.cage import CageBaseline
from fluxobs.comparison.cages import CAGES, SHARED, entries_for
from fluxobs.comparison.catalogue import CATALOGUE
from fluxobs.comparison.compare import compare_scenario
from fluxobs.comparison.scenarios import scenario
from fluxobs.machines import example
from fluxobs.simulation.drive.motor import Motor
from observers.test_cage import CONSTANT, MACHINE, H, record
from support.records import wrapped_degrees

MOTOR = Motor.of(MACHINE)
CAGE_ONLY = [entry for entry in CAGES if entry.name not in SHARED]


class Setting:
    """The machine and the scales of the record."""

    motor, sample_time, speed_e = MOTOR, H, 314.0
    voltage, current, filter_noise = 283.0, 7.1, 0.02


@pytest.fixture(scope="module")
def ideal():
    """Record without offsets."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("observers.test_cage.VOLTAGE_BIAS", 0.0)
        return record(CONSTANT, bias=0.0)


@pytest.mark.parametrize("entry", CAGE_ONLY, ids=lambda entry: entry.name)
def test_without_offsets_all_follow_the_rotor_flux(entry, ideal):
    voltage, current, theta, mechanical = ideal
    best = np.inf
    for gains in entry.candidates(Setting()):
        observer = entry.build(Setting(), gains)
        assert isinstance(observer, CageBaseline)
        guess = observer.run(voltage, current)
        error = wrapped_degrees(np.asarray(guess.theta_e) - theta)
        settled = slice(4800, 13600)  # before the reversal, 3300 rad/s²
        rms = np.sqrt(np.mean(error[settled] ** 2))
        if rms < best:
            best = rms
            flux = np.hypot(*np.asarray(guess.flux)[10000])
            speed = np.asarray(guess.speed_e)[9000:10000].mean()
    assert best < 1.0
    assert flux == pytest.approx(0.99, abs=0.02)
    slip = 2.1 * 5 / 0.9
    assert speed == pytest.approx(mechanical[9000:10000].mean() * MACHINE.n_p + slip, rel=0.02)


def test_machines_get_suitable_observers():
    assert entries_for(MACHINE) is CAGES
    assert entries_for(example("ipm-5kw6")) is CATALOGUE


@pytest.mark.slow
def test_with_offsets_the_least_squares_is_the_best():
    comparison = compare_scenario(scenario("both-biases"), "induction-2kw2")
    errors = {result.name: result.tuned.rms for result in comparison.results}
    assert {entry.name for entry in CAGES} < set(errors)
    for name in ("least squares, tracked", *(result.name for result in comparison.learnt)):
        del errors[name]
    least_squares = errors.pop("least squares")
    assert np.degrees(least_squares) < 0.3
    assert min(errors.values()) > 5 * least_squares
