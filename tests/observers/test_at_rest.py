"""The position at rest: where a salient machine's i_d ripples, its angle must not."""

import numpy as np
import pytest

from fluxobs.machines import example
from support.at_rest import H, estimate_at_rest, interior, record_at_rest

TURNING, END = 0.8, 4.0


def run(machine, creep=0.0, **conditions):
    """Return (errors in degrees, stds, valid) from half a second after the rotor has stopped."""
    t = H * np.arange(round(END / H))
    speed = np.interp(t, [0, TURNING, TURNING + 0.2], [0.3, 0.3, creep])
    record = record_at_rest(machine, speed, seed=5, **conditions)
    estimate = estimate_at_rest(record)
    later = t > TURNING + 0.5
    return (
        record.errors(estimate.theta_e)[later],
        np.degrees(estimate.theta_e_std)[later],
        estimate.valid[later],
    )


@pytest.mark.parametrize(
    ("machine", "options", "rms", "worst"),
    [
        (interior(1.5), {}, 1.5, 6.0),
        (interior(1.5), {"creep": -0.01}, 1.5, 6.0),
        (interior(1.2), {"ripple": 0.05, "noise": 0.005}, 3.0, 12.0),
        (example("ipm-5kw6"), {}, 1.5, 6.0),
        (example("synrm-6kw7"), {"i_d": 0.4}, 1.0, 4.0),
        (example("synrm-6kw7-saturated"), {"i_d": 0.4}, 1.0, 4.0),
    ],
    ids=["interior", "creep", "mild and noisy", "PM-assisted", "reluctance", "saturated"],
)
def test_the_position_at_rest_under_load_steps(machine, options, rms, worst):
    """R is assumed 20 % too large, and the inverter loses 3 V: both are learnt at rest."""
    error, std, valid = run(machine, **options)
    assert valid.mean() > 0.6
    assert np.sqrt(np.mean(error[valid] ** 2)) < rms
    assert error[valid].max() < worst
    assert np.mean(error[valid] < 2 * std[valid]) > 0.93
    assert np.median(std[valid]) < 5 * np.sqrt(np.mean(error[valid] ** 2))  # σ is not useless


@pytest.mark.parametrize(
    ("machine", "options"),
    [
        (interior(1.5), {"ripple": 0.0}),
        (interior(1.5), {"ripple": 0.0, "noise": 0.01}),  # noise ripples the length, too
        (interior(1.5), {"wave": np.repeat([1, -1], 200)}),  # a ripple at 25 Hz
        (example("pmsm-2kw2"), {}),  # the length of a surface machine does not depend on i_d
    ],
    ids=["nothing", "noise", "slow", "surface"],
)
def test_without_excitation_a_position_at_rest_is_lost(machine, options):
    _, std, valid = run(machine, **options)
    assert not valid[len(valid) // 2 :].any()
    assert std[-1] > 20
