"""The test record in exported folders."""

import numpy as np
import pytest

import fluxobs
from fluxobs.simulation.closed_form.firmware_record import firmware_record
from support.records import MACHINES, wrapped_degrees


@pytest.mark.parametrize("name", MACHINES)
def test_the_observer_follows_the_record(name):
    """Valid positions are right, and bad samples are counted."""
    machine = MACHINES[name]
    observer = fluxobs.LeastSquaresObserver.for_machine(machine, sample_time=1e-4)
    record = firmware_record(machine, observer)
    estimate = observer.run(record.voltage, record.current)
    error = wrapped_degrees(estimate.theta_e - record.theta_e)
    if machine.half_turn_ambiguous:
        error = wrapped_degrees(2 * (estimate.theta_e - record.theta_e)) / 2
    assert estimate.valid.sum() > 500
    # With few samples per turn, quadrature errors reach degrees if L/R is short.
    assert np.abs(error[estimate.valid]).max() < 5
    state, _ = observer.resume(observer.init(), record.voltage, record.current)
    counts = observer.counts(state)
    assert counts.bad_currents == counts.absurd == counts.outliers == 1
    assert counts.bad_voltages == 2
