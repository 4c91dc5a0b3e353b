"""A rerun on a log in memory equals an estimation with the same settings."""

import itertools

import numpy as np
import polars as pl
import pytest

import fluxobs
from fluxobs.estimation.rerun import Again
from fluxobs.logs.for_machine import open_for
from fluxobs.logs.scales import measure_scales
from fluxobs.machines import example

TABLE = pl.read_csv(fluxobs.demo_log().path).head(2500)
DRIFT, ADAPTIVE = ("drift",), ("drift", "resistance", "inverter")
#: Pairs that reach each branch; the others are slow.
QUICK = {(DRIFT, -1.0, 0.4), (DRIFT, 0.4, None), (ADAPTIVE, 0.0, None)}
CASES = itertools.product((DRIFT, ADAPTIVE), (0.0, -1.0, 0.4), (None, 0.4))


@pytest.mark.parametrize(
    ("unknowns", "lag", "inverter"),
    [pytest.param(*case, marks=() if case in QUICK else pytest.mark.slow) for case in CASES],
)
def test_a_rerun_equals_an_estimation(unknowns, lag, inverter):
    columns = {name: TABLE[name].to_numpy() for name in TABLE.columns}
    machine = example("servo-400w").with_values(R_s=0.4, inverter_voltage=inverter)
    log = open_for(columns, machine)
    as_processed = log.lagged(lag).less_inverter(
        machine.inverter if unknowns == ("drift",) else None
    )
    rerun = Again(log, measure_scales(as_processed))
    rows = rerun.rows(machine, unknowns, memory=0.02, lag=lag)
    expected = fluxobs.estimate(columns, machine, unknowns=unknowns, memory=0.02, lag=lag)
    for name in expected.estimates.columns:
        np.testing.assert_array_equal(rows.columns[name], expected[name], err_msg=name)
    again = rerun.rows(machine, unknowns, memory=0.02, lag=lag)  # from the cache
    np.testing.assert_array_equal(again.valid, rows.valid)
    assert rows.valid.any() or lag < 0  # with a wrong lag no row may fit
