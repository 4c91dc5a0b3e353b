"""What the error budget advises, on written variances."""

import numpy as np
import pytest

from fluxobs.estimation.budget import LEAST_GAIN, NAMES, Budget
from fluxobs.smoothing.record import QUANTITIES


def budget(**stds):
    """Return the budget of 10 rows with these standard deviations of the position [rad]."""
    variances = np.zeros((len(QUANTITIES), len(NAMES)))
    for name, std in stds.items():
        variances[QUANTITIES.index("theta_e"), NAMES.index(name)] = 10 * std**2
    return Budget(rows=10.0, variances=variances)


def test_the_item_whose_measurement_lowers_the_deviation_is_advised():
    both = budget(L_d=0.03, smoother=0.04)
    assert both.std == pytest.approx(0.05)
    # Without the item, 0.04 of 0.05 rad remain.
    assert both.advice == "measure the inductances under load, and state their standard " + (
        "deviations: σ 2.3° instead of 2.9°"
    )
    both.stated.append("L_d")
    assert both.advice == ""


@pytest.mark.parametrize(("margin", "advised"), [(0.9, False), (1.1, True)])
def test_a_small_gain_is_not_advised(margin, advised):
    """The deviation must fall by more than LEAST_GAIN."""
    gain = margin * LEAST_GAIN
    rest = 0.04
    total = rest / (1 - gain)
    few = budget(L_d=np.sqrt(total**2 - rest**2), smoother=rest)
    assert bool(few.advice) == advised


def test_without_a_valid_row_nothing_is_advised():
    assert Budget().advice == ""
    assert np.isnan(Budget().std)
