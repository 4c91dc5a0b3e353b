"""Fit of a truth channel to closed-form rows: exact parameters; limits tested from both sides."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from fluxobs.estimation import truth
from fluxobs.estimation.truth import (
    BLOCKS,
    LOST,
    TruthParameter,
    TruthSamples,
    _lost,
    _robust,
    _slip,
    fit_truth,
)
from fluxobs.machines import example
from fluxobs.machines.model.frames import wrap

SERVO, SYNRM = example("servo-400w"), example("synrm-6kw7")
H, ROWS = 1e-3, 4000
T = H * np.arange(ROWS)
SPEED = 200 + 80 * np.cos(3 * T)
SHAFT = np.cumsum(SPEED) * H / SERVO.n_p
ESTIMATE_STD = 0.004


def samples(channel, theta, raw, speed=SPEED, size=ROWS, valid=None, **more):
    """Return the samples that a run keeps when it receives its rows in batches of `size`."""
    rows = len(raw)
    kept = TruthSamples(rows, channel)
    columns = {"t": T[:rows], "theta_e": wrap(theta), "theta_e_std": np.full(rows, ESTIMATE_STD)}
    columns |= {"speed_e": np.broadcast_to(speed, (rows,))} | more
    valid = np.ones(rows, bool) if valid is None else valid
    for first in range(0, rows, size):
        rows_of_batch = slice(first, first + size)
        batch = {name: values[rows_of_batch] for name, values in columns.items()}
        kept.add(
            SimpleNamespace(
                columns=batch, valid=valid[rows_of_batch], more={"raw": raw[rows_of_batch]}
            )
        )
    return kept


def fitted(channel, theta, raw, machine=SERVO, **options):
    return fit_truth(samples(channel, theta, raw, **options), machine)


def encoder_error(raw, zero=0.0, delay=0.0, once=(0.0, 0.0), twice=(0.0, 0.0), speed=SPEED):
    """Return estimate minus truth for the given encoder errors [rad]."""
    once_a_turn = once[0] * np.cos(raw) + once[1] * np.sin(raw)
    return (
        zero + delay * speed + once_a_turn + twice[0] * np.cos(2 * raw) + twice[1] * np.sin(2 * raw)
    )


# ---- an encoder -----------------------------------------------------------------------------


@pytest.mark.parametrize("pairs", [4, -4, 7])
@pytest.mark.parametrize("size", [ROWS, 640])
def test_all_faults_of_an_encoder_exactly(pairs, size):
    faults = {"zero": 2.5, "delay": 3e-4, "once": (0.03, 0.04), "twice": (-0.012, 0.005)}
    theta = pairs * SHAFT + encoder_error(SHAFT, **faults)
    fit = fitted("theta_mech", theta, SHAFT, size=size)
    assert fit.pole_pairs == pairs
    assert fit["zero"].value == pytest.approx(2.5)
    assert fit["zero"].std == pytest.approx(ESTIMATE_STD)
    assert fit["delay"].value == pytest.approx(3e-4)
    assert fit["eccentricity 1"].value == pytest.approx(0.05 / abs(pairs))
    assert fit["eccentricity 2"].value == pytest.approx(0.013 / abs(pairs))
    assert fit.rms < 1e-9
    assert fit.most < 1e-9
    assert fit.wrong_turns == (pairs != 4)
    np.testing.assert_allclose(fit.error(theta, SHAFT, SPEED), 0, atol=1e-9)
    words = "; ".join(fit.words)
    assert "zero +143.24° ± 0.23° electrical, " in words
    assert f", {np.degrees(2.5) / abs(pairs):.2f}° of the shaft" in words
    assert re.search(r"300 ± \S+ µs late", words)
    degrees = np.degrees(0.05 / abs(pairs))
    assert f"eccentricity {degrees:.2g}° ± " in words
    assert "of the shaft, once a turn" in words
    assert ("counts opposite" in words) == (pairs < 0)
    assert (f"{abs(pairs)} pole pairs fit, not 4" in words) == (pairs == 7)


def test_the_remaining_error_is_its_rms():
    """No parameter explains an error with five periods per turn."""
    raw = 2 * np.pi * np.arange(ROWS) / 400
    theta = 4 * raw + 0.02 * np.cos(5 * raw)
    fit = fitted("theta_mech", theta, raw)
    assert fit.rms == pytest.approx(0.02 / np.sqrt(2), rel=1e-3)
    assert fit.most == pytest.approx(0.02, rel=1e-3)


def test_a_position_that_is_ambiguous_by_half_a_turn():
    theta = SHAFT + 0.4 + np.pi * (np.arange(ROWS) // 1600 % 2)
    fit = fitted("theta_e", theta, SHAFT, SYNRM)
    assert fit["zero"].value == pytest.approx(0.4)
    assert fit.half_turn
    assert fit.rms < 1e-9


@pytest.mark.parametrize(("spread", "separable"), [(0.29, False), (0.31, True)])
def test_a_delay_needs_a_speed_that_varies(spread, separable):
    """The range of speeds must be 30 % of the largest."""
    speed = 300 * (1 - spread * (1 + np.cos(3 * T)) / 2)
    fit = fitted("theta_mech", 4 * SHAFT + 1e-4 * speed, SHAFT, speed=speed)
    assert ("delay" in fit.known) == separable
    assert any("delay and zero cannot be separated" in words for words in fit.words) != separable


@pytest.mark.parametrize(("bins", "fitted_too"), [(28.5, True), (27.5, False)])
def test_eccentricity_needs_nearly_all_of_a_turn(bins, fitted_too):
    """29 of 32 sectors must be covered."""
    raw = bins / 32 * np.pi * (1 - np.cos(6 * T)) * (1 - 1e-9)
    fit = fitted("theta_mech", 4 * raw, raw)
    assert ("cos 1" in fit.known) == fitted_too
    assert "cos 1" not in fitted("theta_e", SHAFT, SHAFT).known


@pytest.mark.parametrize(
    ("ratio", "accepted"), [(4.07, True), (4.09, False), (3.93, True), (0.4, False)]
)
def test_turns_are_a_whole_number_within_two_percent(ratio, accepted):
    fit = fitted("theta_mech", ratio * SHAFT, SHAFT)
    assert ("not a whole number of pole pairs" in "".join(fit.words)) != accepted
    if not accepted:
        assert (fit.pole_pairs, fit.wrong_turns) == (4, True)
        assert f"turns {ratio:.3g} times" in fit.words[0]


@pytest.mark.parametrize(("turned", "still"), [(1.02, False), (0.98, True)])
def test_an_angle_that_hardly_turns(turned, still):
    """The sum of squared turned angles over spans of 32 rows must exceed one."""
    raw = np.arange(3200) * turned / 31 / 10
    fit = fitted("theta_mech", 4 * raw, raw, speed=1.0)
    assert ("hardly turns" in fit.words[0]) == still


def test_a_mechanical_angle_declared_electrical():
    fit = fitted("theta_e", 4 * SHAFT, SHAFT)
    assert fit.pole_pairs == 4
    assert "the channel is mechanical, with 4 pole pairs" in fit.words[0]
    (words, *_) = fitted("theta_mech", SHAFT, SHAFT).words
    assert words == "1 pole pairs fit, not 4: the channel is electrical (--truth theta_e=…)"


@pytest.mark.parametrize("channel", ["theta_mech", "speed_mech"])
def test_a_fit_needs_ten_rows_per_block(channel):
    for rows, there in ((399, False), (400, True)):
        raw = {"theta_mech": SHAFT, "speed_mech": SPEED / 4}[channel][:rows]
        fit = fitted(channel, 4 * SHAFT[:rows], raw, speed=SPEED[:rows])
        assert (fit is not None) == there
    assert fit_truth(TruthSamples(100, channel), SERVO) is None


@pytest.mark.parametrize(("value", "significant"), [(2.99, False), (3.01, True), (-3.01, True)])
def test_three_standard_deviations_are_significant(value, significant):
    assert TruthParameter("zero", value, 1.0, "rad").told == significant


# ---- thinning ------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [ROWS, 7, 640])
def test_rows_are_kept_evenly_whatever_the_batches(monkeypatch, size):
    monkeypatch.setattr(truth, "MAX_ROWS", 1300)
    valid = np.arange(ROWS) % 5 != 0
    raw = np.where(np.arange(ROWS) % 7, SHAFT, np.nan)
    thinned = samples("theta_mech", 4 * SHAFT, raw, valid=valid, size=size)
    rows = np.arange(0, ROWS, 3)
    rows = rows[valid[rows] & np.isfinite(raw[rows])]
    np.testing.assert_array_equal(thinned.columns()["row"], rows)
    np.testing.assert_array_equal(thinned.columns()["raw"], raw[rows])
    assert thinned.known == (valid & np.isfinite(raw)).sum()


def test_turns_are_counted_over_spans_of_32_usable_rows():
    raw = 0.01 * np.arange(100)
    valid = np.arange(100) != 40
    counted = samples("theta_mech", 3 * raw, raw, valid=valid, speed=1.0)
    turn = 31 * 0.01
    assert counted.turned == pytest.approx(2 * turn)  # one of three spans has a gap
    assert counted.square == pytest.approx(2 * turn**2)
    assert counted.product == pytest.approx(3 * 2 * turn**2)


# ---- robust ---------------------------------------------------------------------------------


def test_equal_errors_within_a_block_count_once():
    """The error is ±1, alternating over 40 blocks: the variance of the mean is 1/39."""
    row = np.arange(4000.0)
    y = np.where(row // 100 % 2, 1.0, -1.0)
    value, covariance, residual = _robust(np.ones((4000, 1)), y, row)
    assert value == pytest.approx([0.0], abs=1e-12)
    assert covariance[0, 0] == pytest.approx(1 / 39)
    np.testing.assert_allclose(residual, y)
    _, scaled, _ = _robust(np.full((4000, 1), 5.0), y, row)
    assert scaled[0, 0] == pytest.approx(1 / 39 / 25)


def test_outliers_count_linearly():
    """Huber's equation holds with errors clipped at 1.345 standard deviations (from the median)."""
    rng = np.random.default_rng(0)
    X = np.stack([np.ones(2000), rng.normal(size=2000)], axis=1)
    y = X @ [0.5, -2.0] + rng.normal(0, 0.1, 2000) + np.where(rng.random(2000) < 0.1, 3.0, 0.0)
    value, _, residual = _robust(X, y, np.arange(2000.0))
    limit = 1.345 * 1.4826 * np.median(np.abs(residual))
    gradient = X.T @ np.clip(residual, -limit, limit)
    assert np.abs(gradient).max() < 1e-3 * limit * 2000
    np.testing.assert_allclose(value, [0.5, -2.0], atol=0.04)


# ---- encoder faults in time -----------------------------------------------------------------

ROW = np.arange(4000.0)
COLUMNS = {"row": ROW, "raw": 0.1 * ROW, "t": H * ROW}


def lost(error, inside, still=False, further=None, typical=0.0):
    """Describe the fault of blocks of 100 rows with an error [°]."""
    block = ROW // 100
    faulty = np.isin(block, list(inside))
    raw = np.where(faulty, 1.0, COLUMNS["raw"]) if still else COLUMNS["raw"]
    residual = np.where(faulty | (block == further), np.radians(error), np.radians(typical))
    return _lost(COLUMNS | {"raw": raw}, residual)


@pytest.mark.parametrize(
    ("error", "typical", "reported"), [(4.9, 0, 0), (5.1, 0, 1), (7.9, 2, 0), (8.1, 2, 1)]
)
def test_a_block_is_lost_beyond_five_degrees_or_four_times_the_typical_error(
    error, typical, reported
):
    words = lost(error, (12, 13, 14), typical=typical)
    assert words == (
        f"from 1.2 to 1.499 s the channel does not follow the flux, error {error:.3g}° rms"
        if reported
        else None
    )


def test_where_an_angle_is_lost():
    assert lost(20, (12, 13, 14), still=True).startswith(
        "from 1.2 to 1.499 s the channel stands still"
    )
    assert lost(20, (3,)).startswith("from 0.3 to 0.399 s the channel does not follow")
    assert lost(20, (38, 39)).endswith("error 20° rms")
    assert lost(20, (12, 13), further=30).endswith("rms, and again later")
    words = "from 1.1 to 3.999 s the channel does not follow the flux, error 20° rms"
    assert lost(20, range(11, 40)) == words
    assert lost(20, range(9, 40)) == "the channel does not follow the flux: error 20° rms"
    assert lost(4.9, range(40)) is None


def test_an_angle_that_hardly_moves_stands_still():
    """An angle that moves by less than 0.1 rad in total stands still."""
    for turned, still in ((0.09, True), (0.11, False)):
        raw = COLUMNS["raw"].copy()
        raw[1300:1500] = np.linspace(0, turned, 200)
        residual = np.where((ROW >= 1200) & (ROW < 1500), 0.5, 0.0)
        assert ("stands still" in _lost(COLUMNS | {"raw": raw}, residual)) == still


@pytest.mark.parametrize(("share", "slips"), [(0.09, True), (0.11, False)])
def test_a_slip_leaves_less_than_a_tenth_of_the_squared_error(share, slips):
    wobble = np.where(ROW % 2, 0.01, -0.01)
    error = 0.2 + np.where(ROW >= 2500, 0.3, 0.0) + wobble
    residual = np.full(4000, np.sqrt(0.01**2 / share))
    fit = _slip(np.ones((4000, 1)), error, COLUMNS, residual)
    assert (fit is not None) == slips
    if fit is not None:
        value, covariance, slip_residual, clause = fit
        assert value == pytest.approx([0.2], abs=1e-4)
        assert covariance.shape == (1, 1)
        np.testing.assert_allclose(slip_residual, wobble, atol=1e-3)
        assert re.match(r"at about 2\.5 s the zero steps by \+17\.2° ± \S+° electrical", clause)


# ---- speed ----------------------------------------------------------------------------------


def test_the_gain_of_a_speed():
    fit = fitted("speed_e", SHAFT, SPEED / 1.02)
    assert fit["gain"].value == pytest.approx(1.02)
    assert fit.rms == pytest.approx(np.sqrt(np.mean((0.02 * SPEED / 1.02) ** 2)))
    assert fit.most == pytest.approx(0.02 * 280 / 1.02, rel=1e-3)
    assert fit.words[0].startswith("ratio of estimated to given speed 1.0200 ± ")
    mechanical = fitted("speed_mech", SHAFT, SPEED / 4, speed_mech=SPEED / 4)
    assert mechanical["gain"].value == pytest.approx(1.0)
    assert fitted("speed_mech", SHAFT, SPEED / 4)["gain"].value == pytest.approx(1.0)


def test_a_speed_with_an_offset():
    """The fit includes gain and offset if the speed varies by 30 %."""
    for spread, exact in ((0.31, True), (0.29, False)):
        true_speed = 300 * (1 - spread * (1 + np.cos(3 * T)) / 2)
        gain = fitted("speed_e", SHAFT, true_speed, speed=1.1 * true_speed + 20)["gain"].value
        assert (abs(gain - 1.1) < 1e-6) == exact


@pytest.mark.parametrize(
    ("gain", "pairs"), [(1.5, 6), (0.75, 3), (1.26, 5), (1.28, None), (1.05, None), (0.25, 1)]
)
def test_pole_pairs_that_a_speed_would_fit(gain, pairs):
    words = fitted("speed_mech", SHAFT, SPEED / 4, speed=gain * SPEED).words
    suggestions = [text for text in words if "pole pairs would fit" in text]
    assert suggestions == ([] if pairs is None else [f"{pairs} pole pairs would fit, not 4"])


@pytest.mark.parametrize(("share", "reported"), [(0.098, False), (0.103, True)])
def test_a_speed_that_does_not_follow(share, reported):
    true_speed = 100 + 50 * np.cos(3 * T)
    estimated = true_speed + share * 150 * np.where(np.arange(ROWS) % 2, 1, -1)
    fit = fitted("speed_e", SHAFT, true_speed, speed=estimated)
    assert (fit.lost is not None) == reported
    assert fit.lost is None or fit.lost.startswith("with the gain corrected, the rms difference is")


def test_a_speed_of_zero():
    fit = fitted("speed_e", SHAFT, np.zeros(ROWS))
    assert fit.words == ("the speed is zero throughout",)
    assert fit.wrong_turns


# ---- Hall sensors ---------------------------------------------------------------------------

CODES = np.array([1, 3, 2, 6, 4, 5])


def hall(zero=0.2, moved=0.0, direction=1):
    """Return angle and code; `moved` displaces the edge between states 3 and 2."""
    theta = direction * np.linspace(0, 60.4, ROWS)
    edges = zero + np.arange(6) * np.pi / 3
    edges[2] += moved
    turned = np.mod(theta[:, None] - edges, 2 * np.pi)
    return theta, CODES[np.argmin(turned, axis=1)].astype(float)


@pytest.mark.parametrize("size", [ROWS, 7])
@pytest.mark.parametrize("direction", [1, -1])
def test_places_of_hall_edges(size, direction):
    """Edges in both directions are exact within one step of the angle, 0.015 rad."""
    fit = fitted("hall", *hall(direction=direction), size=size)
    places = {parameter.name: parameter.value for parameter in fit.parameters}
    pairs = ["1-5", "1-3", "2-3", "2-6", "4-6", "4-5"]
    assert set(places) == {f"edge {pair}" for pair in pairs}
    for n, pair in enumerate(pairs):
        assert wrap(places[f"edge {pair}"] - 0.2 - n * np.pi / 3) == pytest.approx(0, abs=0.008)
    assert fit.rms < 0.0076
    assert fit.most < 0.016
    assert not any("exchanged" in words or "skip" in words for words in fit.words)


def test_a_hall_edge_out_of_place():
    """An edge displaced by 12° moves the common zero by 2°, so the edge's deviation is 10°."""
    fit = fitted("hall", *hall(moved=np.radians(12)))
    assert float(fit.words[-1].split(" is ")[1].rstrip("°")) == pytest.approx(10, abs=0.7)


def test_invalid_hall_codes():
    theta, code = hall()
    fit = fitted("hall", theta, np.where(code == 6, 7.0, code))
    assert any(words.startswith("codes 0 or 7 occur") for words in fit.words)
    assert "33% of the edges skip a state" in fit.words
    assert "only 4 of six edges were seen" in fit.words
    assert "opposite" in fitted("hall", -theta, code).words[0]
    assert fitted("hall", theta, np.full(ROWS, 3.0)) is None


@pytest.mark.parametrize(("machine", "turn"), [(SERVO, 1), (SYNRM, 2)])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_zero_where_errors_wrap(machine, turn, sign):
    """The zero is half a turn; for a machine that is symmetric by half a turn, a quarter turn."""
    zero, noise = sign * np.pi / turn, 0.05 * np.random.default_rng(0).standard_normal(ROWS)
    fit = fitted("theta_e", SHAFT * SERVO.n_p + zero + noise, SHAFT * SERVO.n_p, machine)
    error = turn * (fit["zero"].value - zero)
    assert abs(np.angle(np.exp(1j * error))) / turn < 0.005
    assert fit.rms == pytest.approx(0.05, rel=0.05)


def test_blocks_of_one_row_or_no_row():
    """The rms error of a block is that of its rows, however few."""
    row = np.delete(np.arange(BLOCKS), [3, 7])
    columns = {"row": row, "t": 0.5 * row, "raw": 0.2 * row}
    residual = np.zeros(len(row))
    assert _lost(columns, residual) is None
    residual[row == 5] = 1.1 * LOST
    assert _lost(columns, residual).startswith("from 2.5 to 2.5 s the channel stands still, error")
    residual[row == 5] = 0.9 * LOST
    assert _lost(columns, residual) is None
