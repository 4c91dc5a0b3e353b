"""Sums over the rows of a run, whatever the batches, beside sums over all rows at once."""

import numpy as np
import pytest

from fluxobs.estimation.columns import EstimateRows
from fluxobs.estimation.statistics import Statistics

ROWS = 5000
RNG = np.random.default_rng(5)
T = 2e-4 * np.arange(ROWS)
INNOVATION, ERROR = RNG.normal(size=ROWS), RNG.normal(0.1, 0.02, ROWS)
FLUX = RNG.normal(1.0, 0.1, ROWS)


def run(valid, size):
    """The statistics of rows that come in batches of a size."""
    statistics = Statistics(ROWS)
    for first in range(0, ROWS, size):
        part = slice(first, first + size)
        columns = {"t": T[part], "flux_alpha": FLUX[part]}
        statistics.add(EstimateRows(columns, valid[part], ERROR[part], INNOVATION[part], {}))
    return statistics


@pytest.mark.parametrize("size", [1, 7, 640, 1024, ROWS])
@pytest.mark.parametrize("first", [0, 1, 639, 640, 641, 4999])
def test_sums_are_those_of_all_rows(size, first):
    valid = RNG.random(ROWS) < 0.7
    valid[:first], valid[first] = False, True
    found = run(valid, size)
    assert (found.rows, found.valid) == (ROWS, valid.sum())
    assert (found.first_valid_row, found.first_valid) == (first, T[first])
    assert found.settled == ROWS - first
    assert found.innovation == pytest.approx((INNOVATION[first:] ** 2).sum())
    assert found.mean("flux_alpha") == pytest.approx(FLUX[valid].mean())
    assert found.scored == valid.sum()
    assert found.rms_error == pytest.approx(np.sqrt((ERROR[valid] ** 2).mean()))
    assert found.error_max == np.abs(ERROR[valid]).max()


def test_without_a_valid_row_nothing_is_settled():
    found = run(np.zeros(ROWS, bool), 640)
    assert (found.settled, found.innovation, found.first_valid) == (0, 0.0, None)
