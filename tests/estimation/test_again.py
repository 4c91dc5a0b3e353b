"""A rerun on a log in memory equals an estimation with the same settings."""

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
def test_a_rerun_equals_an_estimation(unknowns, lag, inverter):
    machine = example("servo-400w").with_values(R_s=0.4, inverter_voltage=inverter)
    path = fluxobs.demo_log().path
    log = open_for(path, machine)
    as_processed = log.lagged(lag).less_inverter(
        machine.inverter if unknowns == ("drift",) else None
    )
    rerun = Again(log, measure_scales(as_processed))
    rows = rerun.rows(machine, unknowns, memory=0.02, lag=lag)
    expected = fluxobs.estimate(path, machine, unknowns=unknowns, memory=0.02, lag=lag)
    for name in expected.estimates.columns:
        np.testing.assert_array_equal(rows.columns[name], expected[name], err_msg=name)
    again = rerun.rows(machine, unknowns, memory=0.02, lag=lag)  # from the cache
    np.testing.assert_array_equal(again.valid, rows.valid)
    assert rows.valid.any() or lag < 0  # with a wrong lag no row may fit
