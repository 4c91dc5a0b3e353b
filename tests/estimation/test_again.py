"""A run on rows in memory equals an estimation with the same settings."""

import numpy as np
import pytest

import fluxobs
from fluxobs.estimation.again import Again
from fluxobs.logs.for_machine import open_for
from fluxobs.logs.scales import measure_scales
from fluxobs.machines import example


@pytest.fixture(scope="module")
def servo():
    machine = example("servo-400w")
    log = open_for(fluxobs.demo_log().path, machine)
    return machine, Again(log, measure_scales(log))


@pytest.mark.parametrize("unknowns", [("drift",), ("drift", "resistance", "inverter")])
@pytest.mark.parametrize("lag", [0.0, -1.0, 0.4])
@pytest.mark.parametrize("inverter", [None, 0.4])
def test_other_parameters_give_what_an_estimation_gives(servo, unknowns, lag, inverter):
    machine, again = servo
    changed = machine.with_values(R_s=0.4, inverter_voltage=inverter)
    rows = again.rows(changed, unknowns, memory=0.02, lag=lag)
    path = fluxobs.demo_log().path
    expected = fluxobs.estimate(path, changed, unknowns=unknowns, memory=0.02, lag=lag)
    # estimate measures the signals with that lag, and less the inverter's loss
    close = 0.0 if lag == 0.0 and inverter is None else 1e-6
    for name in expected.estimates.columns:
        given, wanted = np.asarray(rows.columns[name], float), expected[name].astype(float)
        np.testing.assert_allclose(given, wanted, rtol=0.0, atol=close * np.abs(wanted).max())
