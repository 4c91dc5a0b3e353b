"""Mistakes with a true angle, for position vectors in closed form; limits from both sides."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fluxobs.checking.findings import Check, Finding
from fluxobs.checking.segments import Segments
from fluxobs.checking.truth import check_truth
from fluxobs.machines import example

PMSM, SYNRM = example("pmsm-2kw2"), example("synrm-6kw7")
H, ROWS = 1e-4, 400
AT = np.arange(0, ROWS, 4)
SPEEDS = np.array([100.0, 300.0, -200.0, 250.0])
THETA = SPEEDS[:, None] * H * np.arange(ROWS) + np.array([[0.1], [2.0], [-1.0], [3.0]])


def judged(values, channel="theta_e", machine=PMSM, lags=(0,), theta=THETA):
    """Return the findings on a channel for position vectors at `theta`.

    Each further lag rotates the vectors by the angle that the rotor turns in one sample.
    """
    voltage = np.zeros(theta.shape, complex)
    data = Segments(H, voltage, {0: voltage}, values)
    fits = {}
    for lag in lags:
        turned = theta[:, AT] + lag * H * np.gradient(theta, H, axis=1)[:, AT]
        fits[lag] = SimpleNamespace(position=np.exp(1j * turned), share=0.01)
    return check_truth(channel, machine, data, fits, AT, 0.0)


def words(*arguments, **options):
    return [str(finding) for finding in judged(*arguments, **options)]


def test_a_true_angle_fits():
    assert words(THETA) == ["truth: the true angle fits to 0.0° rms"]
    assert judged(THETA)[0].as_given


@pytest.mark.parametrize(
    ("degrees", "blamed"), [(3.9, False), (4.1, True), (-4.1, True), (40, True)]
)
def test_a_zero_is_blamed_from_four_degrees_on(degrees, blamed):
    (text,) = words(THETA - np.radians(degrees))
    if blamed:
        assert f"is off by {degrees:.1f}° electrical: at zero, d must" in text
        assert f"(--offset theta_e={np.radians(degrees):.4g})" in text
    else:
        assert text == f"truth: the true angle fits to {degrees:.1f}° rms"


def test_a_zero_in_degrees_of_the_shaft():
    (text,) = words(THETA / PMSM.n_p - 0.1, channel="theta_mech")
    electrical = np.degrees(0.1 * PMSM.n_p)
    assert f"off by {electrical:.1f}° electrical, {np.degrees(0.1):.2f}° of the shaft" in text
    assert "(--offset theta_mech=0.1)" in text


@pytest.mark.parametrize("samples", [4.0, -4.0])
def test_a_delay_grows_with_the_speed(samples):
    (text,) = words(THETA - samples * H * SPEEDS[:, None])
    assert "a delay of 4.00 samples" in text if samples > 0 else "-4.00" in text or "4.00" in text
    assert text.endswith("late" if samples > 0 else "early")


@pytest.mark.parametrize(("samples", "blamed"), [(2.2, False), (2.5, True)])
def test_a_delay_is_blamed_from_four_degrees_at_the_highest_speed_on(samples, blamed):
    """At 300 rad/s, the rotor turns by 4 degrees in 2.33 samples of 0.1 ms."""
    texts = words(THETA - samples * H * SPEEDS[:, None])
    assert any("grows with the speed" in text for text in texts) == blamed


def test_noise_hides_errors_below_three_times_its_size():
    rng = np.random.default_rng(1)
    noise = np.radians(3.0) * rng.standard_normal(THETA.shape)
    assert "fits to" in words(THETA + noise - np.radians(8.0))[0]
    assert "is off by" in words(THETA + noise - np.radians(10.5))[0]


@pytest.mark.parametrize(("scatter", "fits"), [(35.0, True), (46.0, False)])
def test_an_angle_with_errors_of_forty_degrees_does_not_fit(scatter, fits):
    error = np.radians(scatter) * np.where(np.arange(ROWS) // 4 % 2, 1.0, -1.0)
    error[-4:] = error[0]  # the total rotation is the same as without the error
    assert ("does not fit it" in words(THETA + error)[0]) == (not fits)


@pytest.mark.parametrize(
    ("factor", "channel", "message"),
    [
        (-1.0, "theta_e", "turns against the estimated angle"),
        (180 / np.pi, "theta_e", r"is in degrees \(--scale theta_e=0\.01745329\)"),
        (1 / (2 * np.pi), "theta_e", r"is in turns \(--scale theta_e=6\.283185\)"),
        (180 / np.pi / 3, "theta_e", r"in degrees \(--scale theta_mech=0\.01745329\)"),
        (-180 / np.pi, "theta_e", "in degrees .*; also, the true angle turns against"),
        (
            1 / 3,
            "theta_e",
            (
                "turns 3 times more slowly than the flux: it is a mechanical angle, use --truth "
                "theta_mech"
            ),
        ),
        (1.5, "theta_e", "turns 1.5 times as fast as the flux: is it in radians"),
        (
            1.0,
            "theta_mech",
            ("turns as fast as the flux: it is an electrical angle, use --truth theta_e"),
        ),
        (2 / 3, "theta_mech", r"n_p is 3, but 1\.5 would fit \(poles instead of pole pairs\?\)"),
        (1 / 6, "theta_mech", "n_p is 3, but 6 would fit$"),
    ],
)
def test_the_ratio_of_the_rotations_names_the_mistake(factor, channel, message):
    assert PMSM.n_p == 3
    (text,) = words(factor * THETA, channel=channel)
    assert re.search(message, text), text


@pytest.mark.parametrize(("ratio", "blamed"), [(1.08, False), (1.12, True), (0.92, False)])
def test_a_ratio_within_a_tenth_is_right(ratio, blamed):
    start = THETA[:, :1]
    text = words(start + ratio * (THETA - start))[0]
    assert ("times as fast" in text) == blamed


def test_an_angle_that_is_constant_or_unrelated():
    assert "is constant while the flux turns" in words(np.zeros_like(THETA))[0]
    strange = THETA * np.array([[1.0], [-1.0], [2.0], [0.3]])
    assert "does not follow the rotor" in words(strange)[0]


def test_without_rotation_or_angle_there_is_no_finding():
    assert words(0.02 * THETA, theta=0.02 * THETA) == []
    assert words(np.full_like(THETA, np.nan)) == []


@pytest.mark.parametrize(("square", "has_finding"), [(0.97, False), (1.03, True)])
def test_a_rotation_of_one_radian_is_enough(square, has_finding):
    """The limit applies to the sum of squared rotations over the segments."""
    moved = (THETA[:, AT[-1]] - THETA[:, 0]) ** 2
    small = np.sqrt(square / moved.sum()) * THETA
    assert bool(words(small, theta=small)) == has_finding


def test_half_a_turn_is_no_error_of_a_reluctance_machine():
    assert "fits to 0.0°" in words(THETA + np.pi, machine=SYNRM)[0]
    assert "is off by" in words(THETA + np.pi, machine=PMSM)[0]


def test_another_lag_that_fits_twice_as_well_is_named():
    late = THETA + 3 * H * SPEEDS[:, None]
    (text,) = words(late, lags=(-2, 0, 3))
    assert "with --lag +3 the true angle fits to 0.0° rms, with the given lag to" in text
    assert "with --lag" not in words(THETA + 0.5 * H * SPEEDS[:, None], lags=(0, 0.5))[0]


GIVEN = Check((Finding("lag", "0", True),), 0.02, 0.02)


@pytest.mark.parametrize(
    ("given", "best", "tail"),
    [
        (0.02, 0.02, "."),
        (0.27, 0.02, "; as given, it is 27.0%."),
        (0.01, 0.02, "; as given, it is 1.0%."),
        (np.inf, 0.02, "; as given, the position is never known."),
    ],
)
def test_the_residual_as_text(given, best, tail):
    lines = replace(GIVEN, residual_given=given, residual=best).lines()
    assert lines[-1] == f"Residual of the machine's relation: 2.0% of the flux{tail}"


@pytest.mark.parametrize(("given", "best"), [(None, None), (np.inf, np.inf), (None, 0.1)])
def test_no_residual_no_text(given, best):
    assert replace(GIVEN, residual_given=given, residual=best).lines() == ["lag: 0"]


def test_a_finding_as_text_and_facts():
    finding = Finding("lag", "0 samples", False, ("-1",), "this is sure")
    assert str(finding) == "lag: NOT as given: 0 samples. This is sure. Fits equally well: -1"
    assert finding.facts == {
        "kind": "lag",
        "words": "0 samples",
        "as_given": False,
        "others": ["-1"],
        "sure": "this is sure",
    }
    assert not replace(GIVEN, findings=(finding,)).sound
    assert replace(GIVEN, findings=(finding,)).mistakes == (finding,)
    assert GIVEN.sound
    assert GIVEN.mistakes == ()
