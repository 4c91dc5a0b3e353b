"""The usual injection observer, and who is compared on a record with injection."""

import numpy as np
import pytest

from fluxobs.comparison.baselines import SquareWaveInjection
from fluxobs.comparison.cages import entries_for
from fluxobs.comparison.catalogue import CATALOGUE, INJECTION
from fluxobs.machines import example
from fluxobs.simulation.drive import Motor
from support.at_rest import H, interior, record_at_rest

T = H * np.arange(15_000)


@pytest.mark.parametrize("seed", range(4))
def test_at_rest_and_the_half_turn_in_motion(seed):
    """The loop ends at either end of the rotor; the EMF of the motion that follows decides."""
    speed = np.interp(T, [0.6, 0.8], [0.0, 0.3])
    record = record_at_rest(interior(1.5), speed, seed, loss=0.0, resistance=1.0)
    observer = SquareWaveInjection(Motor.of(record.assumed), H, 2 * np.pi * 10)
    guess = observer.run(record.samples.voltage[1:], record.current[1:])
    error = record.errors(np.append(0.0, guess.theta_e))
    rest, motion = (T > 0.4) & (T < 0.6), T > 1.2
    assert np.minimum(error[rest], 180 - error[rest]).max() < 15.0
    assert np.sqrt(np.mean(error[motion] ** 2)) < 5.0


def test_only_a_record_with_injection_has_it():
    salient, surface = example("ipm-2kw2"), example("pmsm-2kw2")
    assert entries_for(salient, injection=True) == [*CATALOGUE, INJECTION]
    assert entries_for(salient) is entries_for(surface, injection=True) is CATALOGUE
