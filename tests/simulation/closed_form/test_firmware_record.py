"""The record in exported folders."""

import numpy as np
import pytest

import fluxobs
from fluxobs.simulation.closed_form.firmware_record import firmware_record
from support.records import MACHINES, wrapped_degrees


@pytest.mark.parametrize("name", MACHINES)
def test_the_vectors_are_a_drive_that_is_followed(name):
    """The record is no noise: where the observer says that it knows the position, it does."""
    machine = MACHINES[name]
    observer = fluxobs.LeastSquaresObserver.for_machine(machine, sample_time=1e-4)
    record = firmware_record(machine, observer)
    found = observer.run(record.voltage, record.current)
    error = wrapped_degrees(found.theta_e - record.theta_e)
    if machine.half_turn_ambiguous:
        error = wrapped_degrees(2 * (found.theta_e - record.theta_e)) / 2
    assert found.valid.sum() > 500
    # The quadrature of so quick a turn costs degrees where L / R is short.
    assert np.abs(error[found.valid]).max() < 5
    state, _ = observer.resume(observer.init(), record.voltage, record.current)
    counts = observer.counts(state)
    assert counts.bad_currents == counts.absurd == counts.outliers == 1
    assert counts.bad_voltages == 2
