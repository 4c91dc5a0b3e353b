"""The position at rest: where a salient machine's i_d ripples, its angle must not."""

import numpy as np
import pytest

from fluxobs import AdaptiveObserver
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


@pytest.mark.parametrize(
    "machine", [interior(1.5), example("ipm-5kw6")], ids=["interior", "PM-assisted with map"]
)
def test_a_seed_at_rest_becomes_valid_in_motion(machine):
    """The record begins at rest with injection; the position comes from a seed."""
    t = H * np.arange(20_000)
    speed = np.interp(t, [1.0, 1.2], [0.0, 0.1])
    record = record_at_rest(machine, speed, seed=4)
    observer = AdaptiveObserver.for_machine(
        record.assumed, sample_time=H, unknowns=("drift", "resistance", "inverter")
    )
    first = float(record.samples.theta[0])
    state = observer.seed(first + 0.05, record.current[0], theta_e_std=0.1)
    estimate = observer.resume(state, record.samples.voltage[1:], record.current[1:])[1]
    error = record.errors(np.append(first, estimate.theta_e))[1:]
    rest = t[1:] < 1.0
    assert estimate.adapting[rest].mean() > 0.99
    assert np.sqrt(np.mean(error[rest] ** 2)) < 3.0
    assert error.max() < 18.0  # a load step, before R is learnt
    assert estimate.valid[t[1:] > 1.5].mean() > 0.8
