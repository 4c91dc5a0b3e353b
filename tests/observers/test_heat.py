"""The estimated resistance follows a winding that warms up, within its standard deviation."""

from itertools import islice

import numpy as np
import pytest

import fluxobs
from fluxobs.simulation.closed_form import endless

ROWS = 120_000  # 24 s


@pytest.mark.parametrize(
    ("warmer", "warming"),
    [
        (0.25, 40.0),
        *(pytest.param(*w, marks=pytest.mark.slow) for w in ((0.15, 100.0), (0.0, 1.0))),
    ],
)
def test_heat_is_followed(monkeypatch, warmer, warming):
    monkeypatch.setattr(endless, "WARMER", warmer)
    monkeypatch.setattr(endless, "WARMING", warming)
    rows = np.array(list(islice(endless.endless(), ROWS)))
    log = dict(zip(endless.COLUMNS, rows.T, strict=True))
    unknowns = ["drift", "resistance", "inverter"]
    result = fluxobs.estimate(log, "servo-400w", unknowns=unknowns, causal=True)
    cycle = log["t"] // endless.CYCLE * endless.CYCLE
    true = 0.36 * (1 + warmer * (1 - np.exp(-cycle / warming)))
    loaded = log["t"] % endless.CYCLE > 1.5  # the cycle has had load
    normalised_error = np.abs(result["resistance"] - true) / result["resistance_std"]
    assert normalised_error[loaded].max() < 2.5
    valid = result["valid"]
    error = np.abs(result["theta_e_error"])[valid]
    assert np.mean(error > 2 * result["theta_e_std"][valid]) < 0.001
    assert np.degrees(np.sqrt(np.mean(error**2))) < 0.2
