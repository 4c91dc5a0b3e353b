"""A run on rows in memory equals an estimation with the same settings."""

import numpy as np
import pytest

import fluxobs
from fluxobs.estimation.rerun import Again
from fluxobs.logs.for_machine import open_for
from fluxobs.logs.scales import measure_scales
from fluxobs.machines import example


@pytest.mark.parametrize("unknowns", [("drift",), ("drift", "resistance", "inverter")])
@pytest.mark.parametrize("lag", [0.0, -1.0, 0.4])
@pytest.mark.parametrize("inverter", [None, 0.4])
def test_other_parameters_give_what_an_estimation_gives(unknowns, lag, inverter):
    machine = example("servo-400w").with_values(R_s=0.4, inverter_voltage=inverter)
    path = fluxobs.demo_log().path
    log = open_for(path, machine)
    seen = log.lagged(lag).less_inverter(machine.inverter if unknowns == ("drift",) else None)
    again = Again(log, measure_scales(seen))
    rows = again.rows(machine, unknowns, memory=0.02, lag=lag)
    expected = fluxobs.estimate(path, machine, unknowns=unknowns, memory=0.02, lag=lag)
    for name in expected.estimates.columns:
        np.testing.assert_array_equal(rows.columns[name], expected[name], err_msg=name)
    assert again.rows(machine, unknowns, memory=0.02, lag=lag).valid.any()  # from what it kept
