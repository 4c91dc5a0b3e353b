"""The position at rest in a log with injection: the smoother sees the direction."""

import numpy as np
import pytest

import fluxobs
from fluxobs.machines import example
from support.at_rest import H, columns_at_rest, interior, record_at_rest

T = H * np.arange(30_000)
#: Half a second of motion, a stop, a creep, and motion without injection.
SPEED = np.interp(T, [0, 0.5, 0.6, 1.8, 1.9, 2.5, 2.6], [0.3, 0.3, 0.0, 0.0, -0.01, -0.01, 0.3])
RIPPLE = np.where(T < 2.7, 0.02, 0.0)
AT_REST = (T > 0.7) & (T < 2.5)


def estimate(machine, **conditions):
    record = record_at_rest(machine, SPEED, 3, **{"ripple": RIPPLE} | conditions)
    result = fluxobs.estimate(columns_at_rest(record), record.assumed)
    return record.errors(result["theta_e"]), np.degrees(result["theta_e_std"]), result["valid"] > 0


@pytest.mark.parametrize(
    ("machine", "conditions"),
    [
        (interior(1.5), {}),
        (interior(1.2), {"wave": (1, 1, -1, -1), "ripple": 1.5 * RIPPLE}),
        (interior(1.5), {"wave": np.exp(0.4j * np.pi * np.arange(5)), "ripple": 1.5 * RIPPLE}),
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
    middle = (T > 1.1) & (T < 1.7)
    assert not valid[middle].any()
    assert std[middle].min() > 5.0
