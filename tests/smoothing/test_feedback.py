"""The gain of a current controller from the noise of its currents, and what it does to the lag."""

from __future__ import annotations

import numpy as np
import pytest

from fluxobs.machines.model.frames import rotate
from fluxobs.smoothing.feedback import feedback

ROWS, NOISE = 20_000, 0.05


def loop(delay, gains=(30.0, 10.0), seed=1, steps=True):
    """Return voltages, measured currents and angles of a drive with a proportional controller."""
    rng = np.random.default_rng(seed)
    angle = np.cumsum(np.full(ROWS, 0.05))
    noise = NOISE * rng.standard_normal((ROWS, 2))
    smooth = np.stack([np.full(ROWS, 2.0), 5 + np.sin(np.arange(ROWS) / 700)], axis=1)
    voltage = np.tile(100 + 0.01 * np.arange(ROWS)[:, None], 2)
    voltage[delay:] -= noise[:-delay] * np.array(gains)
    if steps:  # of the reference: both jump
        for row in range(900, ROWS, 1700):
            smooth[row:] *= -1.0
            voltage[row + delay :] += 80.0
    return rotate(voltage, angle), rotate(smooth + noise, angle), angle


@pytest.mark.parametrize("delay", [1, 2, 3])
@pytest.mark.parametrize("steps", [False, True])
def test_gain_and_delay_of_a_controller_are_found(delay, steps):
    voltage, current, angle = loop(delay, steps=steps)
    gains, found = feedback(voltage, current, angle, NOISE)
    assert found == delay
    np.testing.assert_allclose(gains, [-30.0, -10.0], rtol=0.05)


def test_without_feedback_and_with_unknown_voltages():
    voltage, current, angle = loop(2, gains=(0.0, 0.0))
    gains, found = feedback(voltage, current, angle, NOISE)
    assert found == 0 or np.abs(gains).max() < 1.0
    voltage, current, angle = loop(2)
    voltage[100:200] = np.nan
    gains, found = feedback(voltage, current, angle, NOISE)
    assert found == 2
    np.testing.assert_allclose(gains, [-30.0, -10.0], rtol=0.05)
    assert feedback(voltage[:4], current[:4], angle[:4], NOISE)[1] in (0, 1)
