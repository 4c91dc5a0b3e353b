"""Differences between two clocks: correlations, compared with brute force, and turning vectors."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from fluxobs import RecordError, read_log
from fluxobs.logs.formats.arrays import ArrayTable
from fluxobs.logs.meaning.guess import name_columns
from fluxobs.logs.time.align import (
    _correlate,
    _energy,
    _summit,
    _turning_speed,
    _width,
    aligned_by_content,
    doubt_of_time,
)
from fluxobs.logs.time.clock import even

H = 1e-3
RNG = np.random.default_rng(2)


def smooth(rows, width=20):
    return np.convolve(RNG.normal(size=rows + width - 1), np.hanning(width), mode="valid")


WAVE = smooth(4000)
WAVE -= WAVE.mean()


@pytest.mark.parametrize("lag", [-700, -1, 0, 5, 1500])
def test_the_shift_of_a_signal(lag):
    """The shift is also found for excerpts of different length."""
    a, b = WAVE[1000:3000], WAVE[1000 + lag : 2500 + lag]
    shift, peak, std, second = _correlate(a, b, H)
    assert shift == pytest.approx(lag * H, abs=0.01 * H)
    assert peak == pytest.approx(1.0)
    assert std < 1e-5
    assert second is None


def test_a_correlation_is_that_of_the_rows_that_overlap():
    """Compare with explicit sums."""
    noisy = WAVE[100:900] + RNG.normal(0, 2.0, 800)
    shift, peak, _, _ = _correlate(WAVE[:700], noisy, H)
    at = round(shift / H)
    assert at == 100
    x, y = WAVE[100:700], noisy[:600]
    assert peak == pytest.approx(x @ y / np.sqrt((x @ x) * (y @ y)))


def test_energies_of_the_overlap():
    x, other = RNG.normal(size=7), 5
    lags = np.arange(-8, 10)
    rows = np.arange(7)
    expected = [(x[(rows >= lag) & (rows < lag + other)] ** 2).sum() for lag in lags]
    np.testing.assert_allclose(_energy(x, lags, other), expected, atol=1e-12)


def test_a_shift_between_samples_is_that_of_the_parabola():
    k = np.arange(3000.0)
    a = np.exp(-(((k - 1500) / 40) ** 2))
    b = np.exp(-(((k - 1500.3) / 40) ** 2))
    shift, _, _, _ = _correlate(a - a.mean(), b - b.mean(), H)
    assert shift == pytest.approx(-0.3 * H, abs=0.01 * H)


def test_the_standard_deviation_of_a_shift_covers_it():
    shifts, stds = [], []
    for _ in range(40):
        a = WAVE[:2000] + RNG.normal(0, 0.5, 2000)
        b = WAVE[:2000] + RNG.normal(0, 0.5, 2000)
        shift, _, std, _ = _correlate(a, b, H)
        shifts.append(shift)
        stds.append(std)
    assert np.median(stds) / np.std(shifts) == pytest.approx(1.0, abs=0.6)


def test_a_periodic_signal_has_a_second_shift():
    """If shifts are ambiguous, the shift with the most rows is returned."""
    k = np.arange(2000)
    wave = np.sin(2 * np.pi * k / 250)
    shift, peak, _, second = _correlate(wave, np.roll(wave, -30), H)
    assert shift == pytest.approx(30 * H, abs=H)
    assert peak > 0.99
    periods = (second - shift) / (250 * H)
    assert periods == pytest.approx(round(periods), abs=0.02)
    assert round(periods) != 0


def test_at_least_a_quarter_of_the_shorter_one_has_to_overlap():
    for rows, is_found in ((620, True), (580, False)):
        a, b = RNG.normal(0, 1.0, 2400), WAVE[:2400].copy()
        a[:rows] = WAVE[2400 - rows : 2400]
        shift, _, _, _ = _correlate(a, b, H)
        assert (abs(shift + (2400 - rows) * H) < H) == is_found


@pytest.mark.parametrize("lag", [40, 90, 99])
def test_a_short_file_late_in_a_long_one(lag):
    """The shifts exceed half of the length of the transform."""
    shift, peak, _, _ = _correlate(WAVE[:128], WAVE[lag : lag + 28], H)
    assert shift == pytest.approx(lag * H, abs=0.1 * H)
    assert peak == pytest.approx(1.0)
    shift, _, _, _ = _correlate(WAVE[lag : lag + 28], WAVE[:128], H)
    assert shift == pytest.approx(-lag * H, abs=0.1 * H)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_peak_at_the_edge_of_the_allowed_overlap_is_not_interpolated(sign):
    """A peak with only one neighbour has no parabola. The peak is at a quarter of the overlap."""
    a, b = RNG.normal(0, 0.1, (2, 400))
    a[:101], b[299:] = 1.0 + np.arange(101), 1.0 + np.arange(101)
    a, b = (a, b) if sign > 0 else (b, a)
    shift, peak, std, _ = _correlate(a, b, H)
    assert shift == pytest.approx(-sign * 299 * H, abs=1e-12)
    assert peak == pytest.approx(1.0)
    assert std == pytest.approx(H * np.sqrt(1e-12 / 101))


@pytest.mark.parametrize("lag", [0, 300])
def test_constant_stretches_do_not_correlate(lag):
    """A current is zero before the start of a drive: sums of zeros are rounding errors."""
    a, b = np.zeros(2000), np.zeros(2000)
    a[1200:1700], b[1200 - lag : 1700 - lag] = WAVE[:500], WAVE[:500]
    shift, peak, _, second = _correlate(a, b, H)
    assert shift == pytest.approx(lag * H, abs=0.1 * H)
    assert peak == pytest.approx(1.0)
    assert second is None


@pytest.mark.parametrize("rows", [2, 3, 4])
def test_a_few_rows_have_a_shift(rows):
    a = np.array([1.0, -1.0, 2.0, -2.0])[:rows]
    assert _correlate(a, a, H)[0] == pytest.approx(0.0, abs=0.5 * H)


def test_uphill_and_to_the_half():
    hill = np.array([0.0, 1.0, 2.0, 4.0, 3.0, 1.9, 1.0, 5.0])
    assert [_summit(hill, at) for at in (1, 2, 3, 4, 5)] == [3, 3, 3, 3, 3]
    assert [_summit(hill, at) for at in (0, 7)] == [0, 7]
    assert _width(hill, 3) == 2
    assert _width(np.ones(5), 2) == 5


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("names", ["alphabeta", "abc", "line", "duty"])
def test_the_speed_of_a_vector_in_any_frame(names, direction):
    k = np.arange(600)
    z = 3 * np.exp(0.05j * direction * k)
    a, b, c = (z[:, None] * np.exp(-2j * np.pi / 3 * np.arange(3))).real.T
    signals = {
        "alphabeta": {"i_alpha": z.real, "i_beta": z.imag},
        "abc": {"u_a": a, "u_b": b},
        "line": {"u_ab": a - b, "u_bc": b - c},
        "duty": {"d_a": 0.5 + a / 9, "d_b": 0.5 + b / 9, "d_c": 0.5 + c / 9},
    }[names]
    speed = _turning_speed(signals, even(600, H))
    np.testing.assert_allclose(speed[:-1], direction * 0.05 / H, rtol=1e-9)
    assert speed[-1] == 0.0


def test_without_a_vector_nothing_turns():
    assert _turning_speed({"u_a": np.ones(30)}, even(30, H)).tolist() == [0.0] * 30


def side(name, columns):
    table = ArrayTable(columns, Path(name))
    (named,) = name_columns([(table.path, [table])])
    return named, table, even(len(next(iter(columns.values()))), H)


def test_of_several_columns_of_both_files_the_first_channel_is_compared():
    """The first channel in the order of COMMON is compared; the second has a different shift."""
    base = side("one", {"i_b": WAVE[:3000], "i_a": WAVE[500:3500]})
    other = side("two", {"i_b": WAVE[90:3090], "i_a": WAVE[540:3540]})
    shift, note = aligned_by_content(base, other)
    assert shift == pytest.approx(0.04, abs=1e-5)
    assert "according to the column i_a of both files" in note


def test_the_clock_offset_is_reported():
    base, other = side("one", {"i_a": WAVE[:3000]}), side("two", {"i_a": WAVE[40:3040]})
    shift, note = aligned_by_content(base, other)
    assert shift == pytest.approx(0.04, abs=1e-5)
    assert "according to the column i_a of both files, the file's clock is -0.04" in note
    assert "correlation 1.000" in note


@pytest.mark.parametrize(("share", "accepted"), [(0.56, True), (0.44, False)])
def test_a_correlation_of_a_half_is_needed(share, accepted):
    noise = smooth(3000)
    mixed = share * WAVE[:3000] / WAVE[:3000].std()
    mixed += np.sqrt(1 - share**2) * noise / noise.std()
    sides = side("one", {"i_a": WAVE[:3000]}), side("two", {"i_a": mixed})
    if accepted:
        assert aligned_by_content(*sides)[0] == pytest.approx(0.0, abs=5 * H)
    else:
        with pytest.raises(RecordError, match="this correlation is too weak to rely on"):
            aligned_by_content(*sides)


@pytest.mark.parametrize(("rows", "doubted"), [(0, False), (1, False), (2, True), (-2, True)])
def test_a_column_of_both_files_reveals_a_shift_of_two_samples(rows, doubted):
    base, other = side("one", {"i_a": WAVE[9:3009]}), side("two", {"i_a": WAVE[9 + rows :][:3000]})
    doubt = doubt_of_time(base, other)
    assert (doubt is not None) == doubted
    assert doubt is None or "although both files have times" in doubt


@pytest.mark.parametrize(("share", "doubted"), [(0.85, True), (0.74, False)])
def test_a_doubt_needs_a_clear_correlation(share, doubted):
    noise = smooth(3000)
    mixed = share * WAVE[30:3030] / WAVE.std() + np.sqrt(1 - share**2) * noise / noise.std()
    sides = side("one", {"i_a": WAVE[:3000]}), side("two", {"i_a": mixed})
    assert (doubt_of_time(*sides) is not None) == doubted


def test_files_without_a_common_changing_signal():
    sides = side("one", {"i_a": np.ones(100)}), side("two", {"i_a": WAVE[:100]})
    assert doubt_of_time(*sides) is None
    with pytest.raises(RecordError, match="two: align='auto' finds no signal that changes"):
        aligned_by_content(*sides)


@pytest.mark.parametrize("options", [{"align": "index"}, {"columns": {"t": "-"}, "sample_time": H}])
def test_row_by_row_the_times_of_the_other_file_are_not_read(tmp_path, options):
    """They may run backwards."""
    k = np.arange(50.0)
    pl.DataFrame({"t": H * k, "i_alpha": k, "i_beta": k}).write_csv(tmp_path / "i.csv")
    pl.DataFrame({"t": -H * k, "u_alpha": 2 * k, "u_beta": k}).write_csv(tmp_path / "u.csv")
    log = read_log(tmp_path / "i.csv", join=[str(tmp_path / "u.csv")], **options)
    (rows,) = log.aligned()
    np.testing.assert_allclose(rows.voltage[1:, 0], 2 * k[:-1], atol=1e-9)
    assert log.sample_time == pytest.approx(H)


def test_notes_on_times_name_the_second_file(tmp_path):
    k = np.delete(np.arange(300.0), range(100, 110))
    for name, channel in (("i", "i"), ("u", "u")):
        columns = {"t": H * k, f"{channel}_alpha": np.cos(k), f"{channel}_beta": np.sin(k)}
        pl.DataFrame(columns).write_csv(tmp_path / f"{name}.csv")
    log = read_log(tmp_path / "i.csv", join=[str(tmp_path / "u.csv")], align="time")
    gaps = [note for note in log.notes if "1 gap" in note]
    assert [note.partition("t has")[0] for note in gaps] == ["", "u.csv: "]
