"""The position at rest: where a salient machine's i_d ripples, its angle must not."""

import numpy as np
import pytest

from fluxobs import AdaptiveObserver
from fluxobs.machines import InteriorPMSM, example
from support.records import driven

H, RATED_SPEED, TURNING, END = 1e-4, 474.0, 0.8, 2.6


def interior(ratio):
    return InteriorPMSM(
        R_s=3.6, L_d=36e-3, L_q=ratio * 36e-3, psi_f=0.545, n_p=3, rated_current=7.0
    )


def run(machine, ripple=0.02, noise=0.002, i_d=0.0, loss=3.0, creep=0.0, period=2):
    """Return (errors in degrees, stds, valid) from half a second after the rotor has stopped."""
    rng = np.random.default_rng(5)
    rows, rated = round(END / H), machine.rated_current
    t = H * np.arange(rows)
    speed = np.interp(t, [0, TURNING, TURNING + 0.2], [0.3, 0.3, creep])
    load = np.where(t % 0.5 > 0.25, 0.7, 0.1)
    load = np.convolve(np.pad(load, (20, 19), mode="edge"), np.ones(40) / 40, "valid")
    square = np.where(np.arange(rows) % period < period / 2, 1.0, -1.0)
    samples = driven(
        machine,
        H,
        RATED_SPEED * speed,
        rated * (i_d + ripple * square + 1j * load),
        inverter=loss,
        smoothing=0.03 * rated,
        voltage_bias=complex(*rng.normal(0, 0.003, 2)) * RATED_SPEED * machine.flux_base(rated),
        noise=noise * rated,
    )
    observer = AdaptiveObserver.for_machine(
        machine.with_values(R_s=1.2 * machine.R_s),
        sample_time=H,
        unknowns=("drift", "resistance", "inverter"),
    )
    estimate = observer.run(samples.voltage, samples.current + rng.normal(0, 0.01 * rated, 2))
    later = t > TURNING + 0.5
    error = np.abs(np.degrees(np.angle(np.exp(1j * (estimate.theta_e - samples.theta)))))
    return error[later], np.degrees(estimate.theta_e_std)[later], estimate.valid[later]


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
        (interior(1.5), {"ripple": 0.02, "period": 400}),  # a ripple at 25 Hz
        (example("pmsm-2kw2"), {}),  # the length of a surface machine does not depend on i_d
    ],
    ids=["nothing", "noise", "slow", "surface"],
)
def test_without_excitation_a_position_at_rest_is_lost(machine, options):
    _, std, valid = run(machine, **options)
    assert not valid[len(valid) // 2 :].any()
    assert std[-1] > 20
