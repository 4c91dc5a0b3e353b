"""Statistics of a run do not depend on the batches."""

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
    """Return the statistics of rows added in batches of `size`."""
    statistics = Statistics(ROWS)
    for first in range(0, ROWS, size):
        batch = slice(first, first + size)
        columns = {"t": T[batch], "flux_alpha": FLUX[batch]}
        statistics.add(EstimateRows(columns, valid[batch], ERROR[batch], INNOVATION[batch], {}))
    return statistics


@pytest.mark.parametrize("size", [1, 7, 640, 1024, ROWS])
@pytest.mark.parametrize("first", [0, 1, 639, 640, 641, 4999])
def test_sums_do_not_depend_on_the_batches(size, first):
    valid = RNG.random(ROWS) < 0.7
    valid[:first], valid[first] = False, True
    statistics = run(valid, size)
    assert (statistics.rows, statistics.valid) == (ROWS, valid.sum())
    assert (statistics.first_valid_row, statistics.first_valid) == (first, T[first])
    assert statistics.settled == ROWS - first
    assert statistics.innovation == pytest.approx((INNOVATION[first:] ** 2).sum())
    assert statistics.mean("flux_alpha") == pytest.approx(FLUX[valid].mean())
    assert statistics.scored == valid.sum()
    assert statistics.rms_error == pytest.approx(np.sqrt((ERROR[valid] ** 2).mean()))
    assert statistics.error_max == np.abs(ERROR[valid]).max()


def test_without_a_valid_row_no_row_is_settled():
    statistics = run(np.zeros(ROWS, bool), 640)
    assert (statistics.settled, statistics.innovation, statistics.first_valid) == (0, 0.0, None)
