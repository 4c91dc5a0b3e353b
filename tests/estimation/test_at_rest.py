"""The position at rest in a log with injection: the smoother sees the direction."""

import numpy as np
import pytest

import fluxobs
from fluxobs.machines import example
from support.at_rest import H, columns_at_rest, interior, record_at_rest

T = H * np.arange(16_000)
#: Motion, a stop, a creep, and motion without injection.
SPEED = np.interp(T, [0, 0.3, 0.4, 0.9, 1.0, 1.3, 1.4], [0.3, 0.3, 0.0, 0.0, -0.01, -0.01, 0.3])
RIPPLE = np.where(T < 1.45, 0.02, 0.0)
ROTATING = np.exp(0.4j * np.pi * np.arange(5))
AT_REST = (T > 0.45) & (T < 1.3)


def estimate(machine, amplitude=1.0, repeat=1, **conditions):
    """Estimate a record whose speed and amplitude change `repeat` times more slowly."""
    ripple = amplitude * np.repeat(RIPPLE, repeat)
    record = record_at_rest(machine, np.repeat(SPEED, repeat), 3, ripple=ripple, **conditions)
    result = fluxobs.estimate(columns_at_rest(record), record.assumed)
    error, std = record.errors(result["theta_e"]), np.degrees(result["theta_e_std"])
    return error[::repeat], std[::repeat], result["valid"][::repeat] > 0


@pytest.mark.parametrize(
    ("machine", "conditions"),
    [
        pytest.param(interior(1.5), {}, marks=pytest.mark.slow),
        pytest.param(
            *(interior(1.2), {"wave": (1, 1, -1, -1), "amplitude": 1.5}),
            marks=pytest.mark.slow,
        ),
        pytest.param(
            *(interior(1.5), {"wave": ROTATING, "amplitude": 1.5, "repeat": 2}),
            marks=pytest.mark.slow,
        ),
        (example("ipm-5kw6"), {}),
        (example("synrm-6kw7"), {"i_d": 0.4}),
    ],
    ids=["half the rate", "mild, a quarter", "rotating", "with a flux map", "reluctance"],
)
def test_every_row_at_rest_and_at_a_creep(machine, conditions):
    """R is assumed 20 % too large, and the inverter loses 3 V."""
    error, std, valid = estimate(machine, **conditions)
    assert valid[AT_REST].mean() > 0.97
    assert np.sqrt(np.mean(error[AT_REST] ** 2)) < 1.5
    assert error[AT_REST & valid].max() < 6.0
    assert np.mean(error[valid] < 2 * std[valid]) > 0.95
    assert np.median(std[AT_REST]) < 4 * np.sqrt(np.mean(error[AT_REST] ** 2))  # σ is not useless
    moving = np.abs(SPEED) > 0.1
    assert valid[moving].mean() > 0.97  # motion with injection and without


def test_a_surface_machine_does_not_show_a_stop():
    _, std, valid = estimate(example("pmsm-2kw2"))
    middle = (T > 0.6) & (T < 0.9)
    assert not valid[middle].any()
    assert std[middle].min() > 5.0
