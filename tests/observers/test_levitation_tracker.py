"""The tracker of a levitated body equals closed forms: motion, corrections, missing rows."""

import numpy as np
import pytest

from fluxobs.machines import example
from fluxobs.observers.levitation_tracker import LevitationTracker

MACHINE = example("maglev-knospe")
H, BANDWIDTH = 2e-3, 200.0
POLE = np.exp(-H * BANDWIDTH)
#: Fluxes whose forces are equal [Wb].
BALANCED = 2e-5 * np.array([np.sqrt(MACHINE.k_1 / MACHINE.c_1), np.sqrt(MACHINE.k_2 / MACHINE.c_2)])


@pytest.fixture
def tracker():
    return LevitationTracker(MACHINE, H, BANDWIDTH)


def rows(flux, position):
    """Return fluxes and currents at these positions."""
    position = np.asarray(position, float)
    flux = np.broadcast_to(flux, (len(position), 2)).copy()
    gaps = np.stack(
        [(MACHINE.g - position) / MACHINE.k_1, (MACHINE.g + position) / MACHINE.k_2], axis=1
    )
    return flux, flux * gaps


def test_a_body_at_rest_stays_at_rest(tracker):
    position, velocity = tracker.run(*rows(BALANCED, np.full(50, 1e-4)))
    np.testing.assert_allclose(position, 1e-4, rtol=1e-12)
    np.testing.assert_allclose(velocity, 0.0, atol=1e-12)


def test_a_constant_force_makes_a_parabola(tracker):
    flux = BALANCED * [1.01, 1.0]
    force = MACHINE.c_1 * flux[0] ** 2 / (2 * MACHINE.k_1)
    force -= MACHINE.c_2 * flux[1] ** 2 / (2 * MACHINE.k_2)
    acceleration = MACHINE.D**2 / MACHINE.J * force
    t = H * np.arange(20)
    assert 0 < acceleration * t[-1] ** 2 < MACHINE.g
    position, velocity = tracker.run(*rows(flux, acceleration * t**2 / 2))
    np.testing.assert_allclose(position, acceleration * t**2 / 2, atol=1e-12 * MACHINE.g)
    np.testing.assert_allclose(velocity, acceleration * t, atol=1e-9)


def test_the_mean_of_two_forces_acts_between_two_rows(tracker):
    flux = np.stack([BALANCED * [1.01, 1.0], BALANCED])
    force = MACHINE.c_1 * (flux[0, 0] ** 2 - flux[1, 0] ** 2) / (2 * MACHINE.k_1)
    acceleration = MACHINE.D**2 / MACHINE.J * force / 2
    reached = acceleration * H**2 / 2
    _, velocity = tracker.run(*rows(flux, [0.0, reached]))
    assert velocity[1] == pytest.approx(acceleration * H)


def test_an_error_is_corrected_with_a_double_pole(tracker):
    """After a jump of the position, the error of row n is (a + b n) pᶰ with the double pole p."""
    jump = 2e-5
    position, velocity = tracker.run(*rows(BALANCED, [0.0, *np.full(40, jump)]))
    assert position[1] == pytest.approx((1 - POLE**2) * jump)
    assert velocity[1] == pytest.approx((1 - POLE) ** 2 / H * jump)
    error = (jump - position[1:]) / jump
    # a and b follow from the first two rows.
    n = np.arange(len(error))
    a, b = error[0], error[1] / POLE - error[0]
    np.testing.assert_allclose(error, (a + b * n) * POLE**n, atol=1e-9)


@pytest.mark.parametrize("spoilt", ["missing", "beyond the gap"])
def test_rows_without_a_position_are_predicted(tracker, spoilt):
    speed = 1e-3
    flux, current = rows(BALANCED, speed * H * np.arange(60))
    undisturbed, velocity = tracker.run(flux, current)
    assert velocity[29] == pytest.approx(speed, rel=0.05)
    if spoilt == "missing":
        current[30:40] = np.nan
    else:
        current[30:40] = 3 * MACHINE.g * flux[30:40] / [MACHINE.k_1, -MACHINE.k_2]
    position, predicted = tracker.run(flux, current)
    np.testing.assert_allclose(predicted[30:40], velocity[29])
    np.testing.assert_allclose(
        position[30:40], undisturbed[29] + velocity[29] * H * np.arange(1, 11)
    )


def test_the_first_known_position_is_the_start(tracker):
    flux, current = rows(BALANCED, np.full(10, 1e-4))
    current[:3] = np.nan
    position, velocity = tracker.run(flux, current)
    np.testing.assert_allclose(position, 1e-4, rtol=1e-12)
    np.testing.assert_allclose(velocity, 0.0, atol=1e-12)
    position, _ = tracker.run(flux, np.full_like(current, np.nan))
    np.testing.assert_array_equal(position, 0.0)


def test_a_missing_flux_exerts_no_force(tracker):
    flux, current = rows(BALANCED * [1.01, 1.0], np.zeros(2))
    flux[1] = np.nan
    _, velocity = tracker.run(flux, current)
    force = MACHINE.c_1 * BALANCED[0] ** 2 * (1.01**2 - 1) / (2 * MACHINE.k_1)
    assert velocity[1] == pytest.approx(MACHINE.D**2 / MACHINE.J * force / 2 * H)


@pytest.mark.parametrize("name", ["sample_time", "bandwidth"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_settings_are_positive(name, value):
    from fluxobs.errors import ObserverError

    with pytest.raises(ObserverError, match=f"{name} must be positive and finite"):
        LevitationTracker(MACHINE, **({"sample_time": H, "bandwidth": BANDWIDTH} | {name: value}))
