"""Settings chosen from the sizes of a machine, against hand calculation."""

import numpy as np
import pytest

from fluxobs import _core
from fluxobs.machines import example
from fluxobs.observers import AdaptiveObserver

SIZES = {
    "resistance": 0.5, "inductance": 1e-3, "L_position": 2e-3, "flux": 0.1, "slope": 3e-3,
    "shortest": 0.25, "rated_current": 10.0, "usual_memory": 0.03, "speed_e": 0.0,
}  # fmt: skip
#: With L/R of 0.5 ms, noise in the resistive drop matters.
SHORT = SIZES | {"resistance": 2.0}


def test_everything_is_chosen():
    chosen = _core.choose(SIZES, 1e-4)
    assert chosen == pytest.approx(
        {
            "sample_time": 1e-4,
            "memory": 0.03,
            "tracker_bandwidth": 2000 / 3,
            "current_noise": 0.02,
            "drift_prior": 1 / 3,  # turns a flux of 0.1 Wb by 0.1 rad in 30 ms
            "flux_base": 0.1,
            "constraint_base": 0.01,
            "constraint_noise": np.hypot(6e-5, 3e-5),
            "current_limit": 250.0,  # L i is then five times the flux
            "length_min": 0.025,
        },
        rel=1e-14,
    )


def test_the_larger_of_two_limits_is_chosen():
    assert _core.choose(SHORT, 1e-4)["drift_prior"] == pytest.approx(0.6)
    assert _core.choose(SIZES | {"L_position": 4e-3}, 1e-4)["current_limit"] == 200.0


def test_given_values_are_used():
    assert _core.choose(SIZES, 1e-4, drift_prior=7.0)["drift_prior"] == 7.0
    short_memory = _core.choose(SIZES, 1e-4, memory=0.01)
    assert (short_memory["memory"], short_memory["tracker_bandwidth"]) == (0.01, 2000.0)
    assert short_memory["drift_prior"] == pytest.approx(1.0)
    noisy = _core.choose(SIZES, 1e-4, current_noise=0.05)
    assert noisy["current_noise"] == 0.05
    assert noisy["constraint_noise"] == pytest.approx(np.hypot(15e-5, 3e-5))


@pytest.mark.parametrize(
    ("sizes", "sample_time", "speed", "memory"),
    [
        (SHORT, 1e-4, 0.0, 0.03),  # the speed is unknown
        (SHORT, 1e-4, 4000.0, 8.75e-3),  # 3.5 (L/R)^2 / h
        (SHORT, 1e-4, 2000.0, 4 * np.pi / 1000),  # a turn at a quarter of the speed
        (SHORT, 1e-4, 100.0, 0.03),
        (SHORT, 1e-3, 1e4, 0.01),  # ten samples
        (SIZES, 1e-4, 4000.0, 0.03),
    ],
)
def test_memory(sizes, sample_time, speed, memory):
    chosen = _core.choose(sizes | {"speed_e": speed}, sample_time)
    assert chosen["memory"] == pytest.approx(memory)
    assert chosen["tracker_bandwidth"] == pytest.approx(2000 / 3)


def guard_tracker(plain):
    """Return the gains of a tracker with two sample times: a triple pole."""
    h, gains = plain["sample_time"], plain["track"]
    share = 1.5 * h * gains[2] / gains[1]  # (1 - pole) / (1 + pole)
    pole = 1 / (1 + 2 * 2 * share / (1 - share))  # twice 1 / pole - 1
    gap = 1 - pole
    return [1 - pole**3, 1.5 * gap**2 * (1 + pole) / (2 * h), gap**3 / (2 * h) ** 2]


@pytest.mark.parametrize(
    ("name", "psi", "drop", "current", "saliency", "L_noise"),
    [
        ("servo-400w", 0.0125, 0.36 * 12.0, 12.0, 0.0, 0.6e-3 * 0.024),
        ("ipm-2kw2", 0.545, 3.6 * 6.1, 6.1, 36e-3 - 51e-3, 36e-3 * 0.0122),
    ],
)
@pytest.mark.parametrize("dc_link", [10.0, 3000.0])
def test_standard_deviations_of_learnt_parameters(
    name, psi, drop, current, saliency, L_noise, dc_link
):
    unknowns = ("drift", "resistance", "inverter", "asymmetry")
    observer = AdaptiveObserver.for_machine(
        example(name), sample_time=1e-4, unknowns=unknowns, dc_link=dc_link
    )
    parameters, plain = observer.parameters(), observer.plain.parameters()
    inverter = max(0.25 * drop, 0.02 * dc_link) / np.sqrt(2)
    resistance, offset = 0.5 * drop / current, 0.02 * current
    std = [0.25, resistance, inverter, inverter, offset, offset, 0.01, 0.01, 0.1, 0.1]
    expected = {
        "std": std,
        "saliency": saliency / psi,
        "psi": 1.0,
        "inverter_mean": 0.0,
        "volt": 1e-4 / psi,
        "over_current": [100 / current, 100 / 6 / current],  # 0.2 and 1.2 of a twentieth
        "over_rated": 1 / current,
        "lag_std": 1.5e-5,
        "delay_std": 2e-5,
        "current_gain_std": 0.01,
        "iron_flux": 0.01 * current * (L_noise / (0.002 * current) - saliency) / psi,
        "magnet_error": 0.015,
        "through_L": (L_noise / psi) ** 2,
        "unmodelled": 0.1 * plain["drift_prior_std"],
        "slow": 0.03 / 100,
        "guard_reinject": 1 - (1 - 2 * plain["h"]) ** 14,
        "guard_track": guard_tracker(plain),
    }
    assert parameters.keys() == {*expected, "projection"}
    for field, value in expected.items():
        np.testing.assert_allclose(parameters[field], value, rtol=1e-13, atol=1e-15, err_msg=field)
