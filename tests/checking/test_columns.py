"""Mistakes that the columns of a log reveal; each limit is tested from both sides."""

from types import SimpleNamespace

import numpy as np
import pytest

from fluxobs.checking.columns import check_columns

ROWS = 3000
PHASE = 0.02 * np.arange(ROWS)
THREE = {f"i_{p}": np.cos(PHASE - k * 2 * np.pi / 3) for k, p in enumerate("abc")}


def findings(channels, first=0, last=None, true=None, **options):
    """Return the findings on the rows `first` to `last` of these channels, as text."""
    last = len(next(iter(channels.values()))) if last is None else last
    requests = []

    def batches(low, high):
        requests.append((low, high))
        for start in range(low, high, 1000):
            yield {
                name: values[start : min(start + 1000, high)] for name, values in channels.items()
            }

    log = SimpleNamespace(
        current_frame="abc",
        first=first,
        last=last,
        channels=batches,
        names=dict.fromkeys(channels) | {name: name for name in channels},
        conversions=dict.fromkeys(channels, (1.0, 0.0)) | options.get("conversions", {}),
        true=None if true is None else SimpleNamespace(channel=true),
    )
    log.names |= options.get("names", {})
    found = check_columns(log)
    assert not any(finding.as_given for finding in found)
    ((low, high),) = requests
    assert first <= low < high <= last
    return [f"{finding.kind}: {finding.words}" for finding in found]


def waves(count=ROWS):
    phase = 0.02 * np.arange(count)
    return {"i_alpha": np.cos(phase), "i_beta": np.sin(phase)}


def test_right_columns_give_no_finding():
    assert findings(waves()) == []
    assert findings(THREE) == []
    assert findings({"t": PHASE, "udc": np.full(ROWS, 540.0), **THREE}) == []


@pytest.mark.parametrize(("difference", "same"), [(0.5e-9, True), (2e-9, False)])
def test_the_same_signal_in_two_columns(difference, same):
    both = {"u_a": 5 * np.cos(PHASE), "i_a": 5 * np.cos(PHASE)}
    both["i_a"][7] -= 5 * difference
    both["u_a"][9], both["i_a"][11] = np.nan, np.inf
    texts = findings(both, names={"u_a": "Ua"})
    message = "columns: u_a (column Ua) and i_a hold the same signal: give each channel its own"
    assert len(texts) == same
    assert all(text.startswith(message) for text in texts)


def test_the_same_column_read_with_different_scales_and_offsets():
    raw = np.cos(PHASE)
    conversions = {"u_a": (2.0, 1.0), "i_a": (-0.1, 3.0)}
    (text,) = findings({"u_a": 2 * raw + 1, "i_a": 3 - 0.1 * raw}, conversions=conversions)
    assert "u_a and i_a hold the same signal" in text


def test_signals_of_zeros_are_constant_not_the_same():
    still = {"u_a": np.zeros(ROWS), "i_a": np.zeros(ROWS)}
    texts = findings(still, names={"u_a": "Ua"})
    assert texts == [
        "columns: u_a (column Ua) never changes: is it the right column?",
        "columns: i_a never changes: is it the right column?",
    ]


def test_a_constant_signal_with_gaps():
    still = np.full(ROWS, 0.25)
    still[10] = np.nan
    assert findings({"u_a": still}) == ["columns: u_a never changes: is it the right column?"]
    assert findings({"u_a": np.full(ROWS, np.nan)}) == []


def unbalanced(gain):
    """Return currents with i_a scaled by `gain`, and their sum as a share of a phase current."""
    share = np.sqrt((gain - 1) ** 2 / 2 / ((gain**2 + 2) / 6))
    return THREE | {"i_a": gain * THREE["i_a"]}, share


@pytest.mark.parametrize(("gain", "blamed"), [(1.33, False), (1.345, True), (2.0, True)])
def test_phase_currents_whose_sum_is_not_zero(gain, blamed):
    currents, share = unbalanced(gain)
    assert (share > 0.3) == blamed
    currents["i_b"] = currents["i_b"] + 7.0  # offsets do not count
    currents["i_c"][5:8] = np.nan
    texts = findings(currents)
    assert len(texts) == blamed
    assert all(
        text.startswith(f"columns: i_a + i_b + i_c is not zero but {share:.0%}") for text in texts
    )


@pytest.mark.parametrize("name", ["i_a", "i_b", "i_c"])
@pytest.mark.parametrize(("gain", "known"), [(1.33, True), (1.345, False)])
def test_a_phase_current_of_the_opposite_sign(name, gain, known):
    (text,) = findings(THREE | {name: -gain * THREE[name]})
    message = (
        f"columns: {name} has the opposite sign (--scale {name}=-1): with the sign reversed, the "
        f"sum is zero"
    )
    assert (text == message) == known


def test_a_spike_does_not_unbalance_the_phases():
    currents = {name: values.copy() for name, values in THREE.items()}
    currents["i_a"][500] += 300.0
    assert findings(currents) == []


@pytest.mark.parametrize(
    ("most", "full"),
    [
        (1.5, None),
        (1.51, 100),
        (100, 100),
        (101, 256),
        (256, 256),
        (257, 512),
        (513, 1000),
        (1000, 1000),
        (1001, 1024),
        (32769, 65536),
        (65536, 65536),
    ],
)
def test_duties_in_counts_or_percent(most, full):
    """The message gives the next larger full scale: 100, 1000, or that of a binary counter."""
    duties = {f"d_{p}": np.linspace(0.1, 1, ROWS) * k for k, p in ((0.3, "a"), (0.5, "b"))}
    duties["d_c"] = -most * np.linspace(0.1, 1, ROWS) ** 2
    duties["d_c"][0] = np.nan
    texts = findings(duties)
    assert len(texts) == (full is not None)
    for text in texts:
        assert f"a duty reaches {most:g}," in text
        assert f"full scale is {full:g}, " in text
        assert text.endswith(" ".join(f"--scale d_{p}={1 / full:.6g}" for p in "abc"))


def test_a_duty_beyond_all_counters_is_the_full_scale():
    (text,) = findings({"d_a": 70000 * np.linspace(0.1, 1, ROWS)})
    assert "full scale is 70000, give --scale d_a=1.42857e-05" in text


@pytest.mark.parametrize(("mean", "blamed"), [(29, False), (31, True), (-31, True)])
def test_whole_numbers_about_a_large_mean(mean, blamed):
    counts = mean + 10.0 * (-1.0) ** np.arange(ROWS)  # the standard deviation is 10
    counts[0] = np.nan
    texts = findings({"i_a": counts, "i_b": np.cos(PHASE)})
    assert len(texts) == blamed
    assert all("raw converter counts" in text and f"(i_a about {mean})" in text for text in texts)


def test_a_column_without_a_number_is_no_count():
    texts = findings({"i_a": np.full(ROWS, np.nan), "i_b": np.cos(PHASE)})
    assert not any("converter" in text for text in texts)


def test_whole_numbers_that_hardly_change():
    (text,) = findings({"i_a": 100.0 + (PHASE > 1)})
    assert "raw converter counts" in text
    assert findings({"i_a": np.full(ROWS, 100.0)}) == [
        "columns: i_a never changes: is it the right column?"
    ]


@pytest.mark.parametrize("fraction", [0.3, 0.7])
def test_fractions_are_not_counts(fraction):
    whole = 100 + np.round(10 * np.cos(PHASE))
    assert findings({"i_a": whole + fraction}) == []
    assert findings({"i_a": whole})[0].startswith("columns: the values are whole")
    assert findings({"i_a": np.full(ROWS, np.nan), "i_b": np.cos(PHASE)}) == []


@pytest.mark.parametrize("channel", ["theta_e", "truth"])
def test_an_angle_that_wraps_in_degrees(channel):
    angle = np.degrees(PHASE) % 360
    (text,) = findings(
        waves() | {channel: angle}, true="theta_mech" if channel == "truth" else None
    )
    name = "theta_mech" if channel == "truth" else "theta_e"
    assert text == (
        f"angle: {name} wraps at 360: it is probably not in radians (--unit {name}=deg)"
    )
    assert findings(waves() | {channel: PHASE % (2 * np.pi)}, true="theta_mech") == []


def test_a_true_speed_is_no_angle_and_an_angle_may_follow_another():
    assert findings(waves() | {"truth": np.degrees(PHASE) % 360}, true="speed") == []
    both = waves() | {"theta_e": PHASE % (2 * np.pi), "truth": PHASE % 1.0}
    (text,) = findings(both, true="theta_e")
    assert "theta_e wraps at 1: " in text
    assert "=turn)" in text


@pytest.mark.parametrize(("count", "blamed"), [(2, False), (3, True)])
def test_spikes_are_reported_from_three_on(count, blamed):
    spiked = waves()
    spiked["i_beta"][500 : 500 + 100 * count : 100] += 30.0
    texts = findings({"d_a": spiked["i_beta"] / 100, **spiked})
    assert len(texts) == blamed
    for text in texts:
        assert text.startswith("spikes: single rows are far from their neighbours (i_beta: 3, ")
        assert f"in {ROWS} rows)" in text


@pytest.mark.parametrize("length", [50_000, 50_001])
def test_twenty_thousand_rows_from_the_middle(length):
    """The rows checked lie in the middle of the rows to be read."""
    spiked = waves(length)
    first, last = 2000, length - 1000
    start = (first + last - 20_000) // 2
    end = start + 20_000
    inside = [start + 1, start + 10, end - 10, end - 2]
    spiked["i_alpha"][[start - 5, start - 1, *inside, end, end + 5]] += 30.0
    (text,) = findings(spiked, first, last)
    assert "(i_alpha: 4, in 20000 rows)" in text


def test_a_short_log_is_checked_from_its_first_to_its_last_row():
    spiked = waves()
    spiked["i_alpha"][[99, 101, 110, 998, 1000]] += 30.0
    (text,) = findings(spiked, 100, 1000)
    assert "(i_alpha: 3, in 900 rows)" in text
