"""Errors of a truth channel are found, with standard deviations; no other errors are reported."""

import re
from itertools import pairwise

import numpy as np
import pytest

import fluxobs
from fluxobs.estimation.truth import FORWARD, TruthSamples, _fit_hall
from fluxobs.machines.model.frames import wrap
from fluxobs.simulation.closed_form.demo import LOG, MACHINE

TABLE = np.genfromtxt(LOG, delimiter=",", names=True)
H, N_P = 2e-4, 4
GOOD = {name: TABLE[name] for name in ("t", "u_alpha", "u_beta", "i_alpha", "i_beta")}
THETA = np.unwrap(TABLE["theta_e"])


def fitted(channel, columns, **options):
    layout = {"truth": {channel: ",".join(columns)}} | options
    return fluxobs.estimate(
        GOOD | columns, MACHINE, unknowns="drift,resistance,inverter", causal=True, **layout
    )


def encoder(zero=0.0, delay=0.0, once=0.0, twice=0.0, direction=1, pairs=N_P):
    t = np.arange(len(THETA)) * H
    shaft = np.interp(t - delay, t, THETA) / pairs
    error = zero + once * np.cos(shaft + 1.0) + twice * np.sin(2 * shaft)
    return {"angle": np.mod(direction * (shaft - error), 2 * np.pi)}


def degrees(parameter):
    return np.degrees([parameter.value, parameter.std])


def test_an_exact_encoder_has_no_errors():
    result = fitted("theta_mech", encoder())
    fit = result.truth_fit
    assert fit.pole_pairs == N_P
    assert not any(parameter.told for parameter in fit.parameters)
    assert "fitted to the estimate" not in result.summary
    assert np.degrees(fit.rms) < 0.17


@pytest.mark.parametrize("direction", [1, -1])
def test_an_encoder_with_all_faults(direction):
    faults = {"zero": 0.3, "delay": 60e-6, "once": 0.02, "twice": 0.008}
    fit = fitted("theta_mech", encoder(**faults, direction=direction)).truth_fit
    assert fit.pole_pairs == direction * N_P
    value, std = degrees(fit["zero"])
    assert abs(np.angle(np.exp(1j * np.radians(value - np.degrees(N_P * 0.3))))) < 3 * np.radians(
        std
    )
    assert abs(fit["delay"].value - 60e-6) < 3 * fit["delay"].std
    for name, true in (("eccentricity 1", 0.02), ("eccentricity 2", 0.008)):
        assert abs(fit[name].value - true) < 3 * fit[name].std + 1e-4
        assert fit[name].std < 1e-3
    assert np.degrees(fit.rms) < 0.17
    words = " ".join(fit.words)
    assert ("counts opposite" in words) == (direction < 0)
    assert "late" in words
    assert "once a turn" in words


@pytest.mark.parametrize("pairs", [3, 5, 8])
def test_pole_pairs_are_counted(pairs):
    result = fitted("theta_mech", encoder(pairs=pairs))
    assert result.truth_fit.pole_pairs == pairs
    assert f"{pairs} pole pairs fit, not {N_P}" in result.summary
    assert np.degrees(result.truth_fit.rms) < 0.17


def test_an_electrical_angle_given_as_mechanical():
    result = fitted("theta_mech", {"angle": np.mod(THETA, 2 * np.pi)})
    assert "the channel is electrical" in result.summary


def test_a_channel_that_is_not_an_angle():
    rng = np.random.default_rng(0)
    noise = np.cumsum(rng.standard_normal(len(THETA)))
    result = fitted("theta_mech", {"angle": np.mod(noise, 2 * np.pi)})
    assert "not a whole number of pole pairs" in result.summary


def test_no_fit_if_the_truth_is_taken_as_given():
    result = fitted("theta_mech", encoder(zero=0.3), fit_truth=False)
    assert result.truth_fit is None
    assert "mean" in result.summary


def test_the_standard_deviation_of_a_delay_covers_it():
    """In each segment of the log, the delay is within three standard deviations."""
    normalised_errors = []
    for start, stop in ((0.0, 0.7), (0.5, 1.2), (0.9, 1.6), (1.1, 2.0)):
        fit = fitted("theta_mech", encoder(delay=60e-6), start=start, stop=stop).truth_fit
        delay = fit["delay"]
        normalised_errors.append((delay.value - 60e-6) / delay.std)
        assert delay.std < 5e-6
    assert np.abs(normalised_errors).max() < 3


def test_sine_and_cosine_of_an_encoder_in_counts():
    shaft = THETA / N_P - 0.2
    columns = {"s": 2048 + 900 * np.sin(shaft), "c": 2100 + 950 * np.cos(shaft)}
    fit = fitted("sincos", columns).truth_fit
    zero, std = degrees(fit["zero"])
    assert abs(zero - np.degrees(0.2 * N_P)) < 3 * std
    assert np.degrees(fit.rms) < 0.5


@pytest.mark.parametrize(("unit", "factor"), [("rpm", 30 / np.pi), ("rad/s", 1.0)])
def test_speed(unit, factor):
    speed = np.gradient(THETA, H) / N_P
    layout = {"unit": {"speed": unit}}
    result = fitted("speed_mech", {"n": factor * speed}, **layout)
    gain = result.truth_fit["gain"]
    assert abs(gain.value - 1) < 0.005
    assert "rad/s rms" in result.summary
    doubled = fitted("speed_mech", {"n": factor * speed / 2}, **layout)
    assert "8 pole pairs would fit, not 4" in doubled.summary


@pytest.mark.parametrize("channel", ["speed_mech", "theta_mech", "sincos", "hall"])
def test_a_dead_sensor_does_not_raise(channel):
    columns = {
        name: np.zeros(len(THETA)) for name in {"sincos": "ab", "hall": "abc"}.get(channel, "a")
    }
    assert fitted(channel, columns).summary


def hall(order="abc", zero=0.1, shift=0.0):
    """Return signals of sensors at 0°, 120°, 240° of the flux; `shift` moves the second sensor."""
    angle = THETA + zero
    signals = {}
    for n, name in enumerate("abc"):
        phase = np.mod(angle - 2 * n * np.pi / 3 - (shift if n == 1 else 0.0), 2 * np.pi)
        signals[name] = (phase < np.pi).astype(float)
    return {f"hall_{new}": signals[old] for new, old in zip("abc", order, strict=True)}


def test_hall_edges():
    fit = fitted("hall", hall()).truth_fit
    assert len(fit.parameters) == 6
    places = np.sort([parameter.value for parameter in fit.parameters])
    expected = np.sort(np.angle(np.exp(1j * (np.arange(6) * np.pi / 3 - 0.1))))
    np.testing.assert_allclose(places, expected, atol=np.radians(1.0))
    assert "exchanged" not in " ".join(fit.words)


def test_a_hall_sensor_out_of_place():
    fit = fitted("hall", hall(shift=np.radians(8))).truth_fit
    worst = float(fit.words[-1].split(" is ")[-1].rstrip("°"))
    assert 4 < abs(worst) < 8  # relative to the zero of all other edges


def test_hall_wires_exchanged():
    fit = fitted("hall", hall("bac")).truth_fit
    assert "two Hall wires are exchanged" in " ".join(fit.words)


def test_hall_edges_are_midway_between_both_directions():
    """The sensor has hysteresis; edges occur thirty times forwards and six times backwards."""
    edges = []
    for k, (a, b) in enumerate(pairwise([*FORWARD, FORWARD[0]])):
        true = np.pi / 3 * k
        edges += 30 * [(a, b, true + 0.02, 1.0)] + 6 * [(b, a, true - 0.02, -1.0)]
    samples = TruthSamples(1, "hall", edges=[np.transpose(edges)])
    fit = _fit_hall(samples)
    errors = [wrap(6 * parameter.value) / 6 for parameter in fit.parameters]
    np.testing.assert_allclose(errors, 0.0, atol=1e-9)
    assert fit.rms == pytest.approx(0.02)
    assert not any("opposite" in words and "turns" in words for words in fit.words)


def test_a_broken_hall_wire():
    columns = hall() | {"hall_b": np.zeros(len(THETA))}
    assert "a wire is broken" in " ".join(fitted("hall", columns).truth_fit.words)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("channel", ["theta_e", "speed_mech", "hall", "half a code"])
def test_a_truth_without_values_is_reported(channel):
    values = np.full(len(THETA), 1.5 if channel == "half a code" else np.nan)
    result = fitted({"half a code": "hall"}.get(channel, channel), {"a": values})
    assert result.truth_fit is None
    words = "known on only 0 of" if channel == "theta_e" else "has no value on any valid row"
    assert any(words in warning for warning in result.warnings)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_infinite_angles_are_ignored():
    angle = encoder()["angle"]
    angle[100:200] = np.inf
    result = fitted("theta_mech", {"angle": angle})
    assert result.truth_fit.pole_pairs == N_P
    assert np.degrees(result.statistics.rms_error) < 0.17


def test_sine_and_cosine_without_values():
    columns = {"s": np.full(len(THETA), np.nan), "c": np.ones(len(THETA))}
    with pytest.raises(fluxobs.RecordError, match=r"'s' of truth={'sincos': 's,c'} holds"):
        fitted("sincos", columns)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_every_second_current_missing():
    current = np.where(np.arange(len(THETA)) % 2, GOOD["i_alpha"], np.nan)
    result = fluxobs.estimate(GOOD | {"i_alpha": current}, MACHINE, unknowns="drift", causal=True)
    assert any(": 5000 rows have no current" in warning for warning in result.warnings)
    assert not any("nan" in warning for warning in result.warnings)


@pytest.mark.parametrize(
    ("after", "words"),
    [
        (lambda angle: angle[6000], r"from 1\.1\d+ to 2 s the channel stands still"),
        (lambda angle: angle + 0.3, r"at about 1\.[12]\d* s the zero steps by -6[89].* electrical"),
        (lambda angle: angle + 0.05, r"at about 1\.[12]\d* s the zero steps by -11.[12345]"),
    ],
)
def test_an_encoder_that_stops_or_slips(after, words):
    angle = encoder()["angle"]
    angle = np.mod(np.where(np.arange(len(THETA)) > 6000, after(angle), angle), 2 * np.pi)
    result = fitted("theta_mech", {"angle": angle})
    assert re.match(words, result.truth_fit.lost)
    assert any(result.truth_fit.lost in warning for warning in result.warnings)


def test_a_speed_that_drops_out():
    speed = np.gradient(THETA, H) / N_P
    result = fitted("speed_mech", {"w": np.where(np.arange(len(THETA)) > 6000, 0.0, speed)})
    assert "of the largest speed" in result.truth_fit.lost
    assert fitted("speed_mech", {"w": speed}).truth_fit.lost is None


def test_errors_that_repeat_within_a_turn_are_in_the_standard_deviations():
    """Rows within a turn are not independent.

    No parameter explains an error with three periods per turn. This error counts once per turn, and
    for the delay once in the whole range of speed.
    """
    faults = encoder(zero=0.1, once=0.01, delay=50e-6)
    shaft = THETA / N_P
    faults["angle"] = np.mod(faults["angle"] + 0.02 * np.cos(3 * shaft), 2 * np.pi)
    fit = fitted("theta_mech", faults).truth_fit
    assert fit.rms == pytest.approx(N_P * 0.02 / np.sqrt(2), rel=0.05)
    turns = np.abs(np.diff(shaft)).sum() / (2 * np.pi)
    speeds = np.ptp(np.gradient(THETA, H))
    assert fit["eccentricity 1"].std > 0.9 * fit.rms / np.sqrt(turns) / N_P
    assert fit["eccentricity 1"].std < 3 * fit.rms / np.sqrt(turns) / N_P
    assert fit["delay"].std > 0.9 * fit.rms / speeds
    assert fit["delay"].std < 3 * fit.rms / speeds
