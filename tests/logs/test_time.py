"""Time of a log: units, rounding, wraps, gaps and jitter; files that are joined by time."""

import numpy as np
import polars as pl
import pytest

from fluxobs import RecordError
from fluxobs.logs import read_log
from fluxobs.logs.time.clock import rounded_rate, rounding_of
from fluxobs.logs.time.resample import resample

H, ROWS = 1e-4, 4000
SPEED = 300.0


def signals(t):
    """Return (voltages, currents) at times t [s]; voltages are means over the next interval."""
    phase = SPEED * t + 3 * np.sin(20 * t)
    i = (4 + np.sin(11 * t)) * np.exp(1j * phase)
    u = (10 + 2 * np.cos(9 * t)) * np.exp(1j * (phase + 1))
    return u, i


def columns(t, stamps=None):
    u, i = signals(t)
    return {
        "t": t if stamps is None else stamps,
        "u_alpha": u.real,
        "u_beta": u.imag,
        "i_alpha": i.real,
        "i_beta": i.imag,
    }


T = np.arange(ROWS) * H


def rows_of(log, **options):
    batches = list(log.aligned(**options))
    return [np.concatenate([batch[n] for batch in batches]) for n in range(3)]


@pytest.mark.parametrize(
    ("scale", "unit", "noted"),
    [
        (1.0, {}, None),
        (1e3, {}, "ms"),
        (1e6, {}, "us"),
        (1e9, {}, "ns"),
        (170e6, "ticks:170e6", ""),
    ],
)
def test_units_of_time(scale, unit, noted):
    layout = {"unit": {"t": unit}} if unit else {}
    log = read_log(columns(T, np.round(scale * T, 6)), **layout)
    assert log.sample_time == pytest.approx(H, rel=1e-9)
    assert any(f"suggest {noted}" in note for note in log.notes) == bool(noted)


@pytest.mark.parametrize("digits", [3, 4, 5])
def test_rounded_stamps(digits):
    log = read_log(columns(7 * T, np.round(7 * T, digits)))
    assert log.sample_time == pytest.approx(7 * H, rel=1e-9)
    np.testing.assert_array_equal(rows_of(log)[1][:, 0], signals(7 * T)[1].real)
    assert any("rounded" in note for note in log.notes) == (digits == 3)


def test_rounding_and_rates_by_hand():
    assert rounding_of(np.round(np.arange(500) * 0.013, 2)) == pytest.approx(0.01)
    assert rounding_of(np.arange(500) * np.pi / 1000) == 0.0
    assert rounded_rate(1.00003e-4, 1e-8) == pytest.approx(1e-4)
    assert rounded_rate(1.6666e-4, 1e-7) == pytest.approx(1 / 6000)


@pytest.mark.parametrize(
    ("wrap", "scale", "layout"),
    [
        (2**32, 1e6, {"unit": {"t": "us"}}),
        (2**16, 1e6, {"unit": {"t": "us"}}),
        (2**16, 170e3, {"unit": {"t": "ticks:170e3"}}),
        (2**10, 1e6, {"unit": {"t": "us"}}),
    ],
)
def test_counters_that_start_again(wrap, scale, layout):
    stamps = np.mod(np.round(scale * T) + wrap - 1000, wrap)
    log = read_log(columns(T, stamps), **layout)
    t, i, _ = rows_of(log)
    np.testing.assert_allclose(np.diff(t), H, rtol=1e-6)
    np.testing.assert_array_equal(i[:, 0], signals(T)[1].real)
    assert any("wraps every" in note for note in log.notes)


@pytest.mark.parametrize("missing", [1, 2, 9])
def test_samples_lost_where_a_counter_starts_again(missing):
    stamps = np.mod(np.round(1e6 * T) + 2**16 - 1000, 2**16)
    at = int(np.flatnonzero(np.diff(stamps) < 0)[0])
    keep = np.ones(ROWS, bool)
    keep[at + 1 : at + 1 + missing] = False
    log = read_log({n: v[keep] for n, v in columns(T, stamps).items()}, unit={"t": "us"})
    assert len(log) == ROWS
    assert log.clock.missing == missing
    np.testing.assert_allclose(np.diff(rows_of(log)[0]), H, rtol=1e-6)


def test_midnight(tmp_path):
    seconds = np.mod(86400 - 0.2 + T, 86400)
    stamps = [f"{int(s // 3600):02d}:{int(s // 60) % 60:02d}:{s % 60:09.6f}" for s in seconds]
    frame = pl.DataFrame(columns(T)).with_columns(t=pl.Series(stamps))
    frame.write_csv(tmp_path / "log.csv")
    log = read_log(tmp_path / "log.csv")
    assert log.sample_time == pytest.approx(H)
    assert len(log) == ROWS
    np.testing.assert_allclose(np.diff(rows_of(log)[0]), H, rtol=1e-4)


# ---- gaps ------------------------------------------------------------------------------------

GAPS = [(700, 1), (1500, 2), (2000, 57), (3990, 3)]


def without_gaps():
    keep = np.ones(ROWS, bool)
    for at, count in GAPS:
        keep[at : at + count] = False
    return keep


@pytest.mark.parametrize("size", [1, 7, 500, 100_000])
@pytest.mark.parametrize("kind", ["arrays", "csv"])
def test_gaps_become_missing_samples(tmp_path, size, kind):
    keep = without_gaps()
    data = {name: values[keep] for name, values in columns(T).items()}
    source = data
    if kind == "csv":
        source = tmp_path / "log.csv"
        pl.DataFrame(data).write_csv(source)
    log = read_log(source)
    assert (len(log), log.clock.missing) == (ROWS, ROWS - keep.sum())
    t, i, u = rows_of(log, size=size)
    np.testing.assert_allclose(t, T, atol=1e-9)
    np.testing.assert_allclose(i[keep, 0], signals(T)[1].real[keep])
    assert np.isnan(i[~keep]).all()
    np.testing.assert_allclose(u[1:, 0][keep[:-1]], signals(T)[0].real[:-1][keep[:-1]])
    assert np.isnan(u[1:][~keep[:-1]]).all()
    assert any("4 gaps, in which 63 samples are missing" in note for note in log.notes)
    offset = 2 if kind == "csv" else 1
    assert log.table.place(3000).endswith(str(3000 - 60 + offset))
    for at, row in ((700, 699), (2000, 1996), (2056, 1996), (2057, 1997)):  # within and after gaps
        assert log.table.place(at).endswith(str(row + offset)), at


@pytest.mark.parametrize("share", [0.005, 0.02, 0.05, 0.12])
def test_single_samples_lost_at_random(share):
    keep = np.random.default_rng(1).random(ROWS) > share
    keep[[0, -1]] = True
    log = read_log({name: values[keep] for name, values in columns(T).items()})
    i = rows_of(log)[1]
    assert log.sample_time == pytest.approx(H, rel=1e-6)
    assert len(log) == ROWS
    np.testing.assert_allclose(i[keep, 0], signals(T)[1].real[keep])
    assert np.isnan(i[~keep]).all()


@pytest.mark.parametrize("factor", [1.3, 1.01])
def test_a_rate_that_changes_is_refused(factor):
    t = T.copy()
    t[2000:] = t[1999] + factor * H * np.arange(1, ROWS - 1999)
    with pytest.raises(RecordError, match=r"the sample rate changes|not uniform"):
        read_log(columns(T, t))


def test_the_longest_gap_is_named_with_its_place():
    """The longest gap is not the gap after the longest segment."""
    keep = np.ones(ROWS, bool)
    keep[1000:1090], keep[3500:3507] = False, False
    log = read_log({name: values[keep] for name, values in columns(T).items()})
    longest = f"the longest is {90 * H:.3g} s before t = {1090 * H:.6g} s"
    assert any(longest in note for note in log.notes), log.notes


def test_a_time_within_a_shortened_gap():
    t = T.copy()
    t[2000:] += 50.2
    cut = read_log(columns(T, t), start=2.45)
    assert np.isfinite(rows_of(cut)[1][:, 0]).sum() == ROWS - 2000
    cut = read_log(columns(T, t), stop=2.45)
    assert np.isfinite(rows_of(cut)[1][:, 0]).sum() == 2000


def test_parts_of_a_log_with_gaps():
    keep = without_gaps()
    log = read_log({name: values[keep] for name, values in columns(T).items()})
    whole = rows_of(log)
    for first, last in ((0, 5), (699, 705), (1990, 2080), (3000, ROWS)):
        for excerpt, complete in zip(rows_of(log, first=first, last=last)[:2], whole, strict=False):
            np.testing.assert_array_equal(excerpt, complete[first:last])
    cut = read_log({n: v[keep] for n, v in columns(T).items()}, start=0.15, stop=0.3)
    assert (cut.first, cut.last) == (1500, 3001)


def test_a_pause_of_an_hour_is_shortened_and_its_time_kept():
    t = np.concatenate([T[:1000], 3600 + T[:1000]])
    log = read_log(columns(np.concatenate([T[:1000], T[:1000]]), t))
    times, i, _ = rows_of(log)
    assert len(log) == 12_000
    assert times[-1] == pytest.approx(3600 + T[999])
    assert np.isnan(i[1000:11_000]).all()
    assert np.isfinite(i[11_000:]).all()
    assert (np.diff(times) > 0).all()


# ---- jitter ----------------------------------------------------------------------------------


def held_means(edges, values, t):
    """Compute, by brute force, means over [t, t + H] of values that are held between edges."""
    means = []
    for start in t:
        fine = start + (np.arange(2000) + 0.5) / 2000 * H
        means.append(values[np.clip(np.searchsorted(edges, fine, "right") - 1, 0, None)].mean())
    return np.array(means)


@pytest.mark.parametrize("size", [13, 1000, 100_000])
def test_jittering_samples_are_brought_to_uniform_times(size):
    rng = np.random.default_rng(3)
    t = T + H * rng.uniform(-0.2, 0.2, ROWS)
    log = read_log(columns(t))
    assert any("jitters by" in n and "resampled to uniform times" in n for n in log.notes)
    times, i, u = rows_of(log, size=size)
    inside = slice(20, 380)
    at = times[inside]
    np.testing.assert_allclose(i[inside, 0], signals(at)[1].real, atol=2e-5)
    held = held_means(t, signals(t)[0].real, at)
    np.testing.assert_allclose(u[21:381, 0], held, atol=0.01)
    np.testing.assert_allclose(np.diff(times), log.sample_time, rtol=1e-9)


def test_jittering_stamps_of_even_samples_are_ignored():
    rng = np.random.default_rng(3)
    log = read_log(columns(T, T + H * rng.uniform(-0.2, 0.2, ROWS)))
    assert any("only the stamps jitter" in note for note in log.notes)
    np.testing.assert_array_equal(rows_of(log)[1][:, 0], signals(T)[1].real)
    assert log.sample_time == pytest.approx(H, rel=1e-4)


def test_jitter_with_gaps_and_wraps():
    rng = np.random.default_rng(3)
    t = T + H * rng.uniform(-0.2, 0.2, ROWS)
    keep = without_gaps()
    data = {name: values[keep] for name, values in columns(t).items()}
    plain = rows_of(read_log(data))
    assert np.isnan(plain[1][2000:2057]).all()
    assert np.isfinite(plain[1][2070:3980]).all()
    data["t"] = np.mod(data["t"] + 0.06, 2**16 / 1e6)
    wrapped = rows_of(read_log(data))
    np.testing.assert_allclose(wrapped[1], plain[1], atol=1e-6)


def test_too_much_jitter_is_refused():
    rng = np.random.default_rng(3)
    with pytest.raises(RecordError, match="samples are not uniform: a step of"):
        read_log(columns(T, T + H * rng.uniform(-0.45, 0.45, ROWS)))


def test_resampling_by_hand():
    s = np.array([0.0, 1.0, 2.0, 4.0, 5.0])
    values = np.array([1.0, 3.0, 5.0, 9.0, 11.0])
    np.testing.assert_allclose(resample("smooth", s, values, np.array([0.5, 3.0]), 1.0), [2, 7])
    # The held signal is 1 until time 1, 3 until time 2, and 5 until time 4.
    resampled = resample("held", s, values, np.array([0.5, 1.5, 3.5]), 1.0)
    np.testing.assert_allclose(resampled, [2.0, 4.0, 7.0])
    angle = np.mod(0.9 * s + 5.9, 2 * np.pi)
    resampled = resample("angle", s, angle, np.array([0.5]), 1.0)
    np.testing.assert_allclose(resampled, np.mod(0.45 + 5.9, 2 * np.pi))
    np.testing.assert_array_equal(resample("state", s, values, np.array([1.9, 4.0]), 1.0), [3, 9])
    assert np.isnan(resample("smooth", s, values, np.array([-1.0, 6.0]), 1.0)).all()


# ---- several files ---------------------------------------------------------------------------


def write_two_files(tmp_path, shift=0.0, rate=1, start=0.0, with_common_column=False):
    """Write currents to one file, and voltages to a second file with a different clock."""
    t = T + start
    i = signals(t)[1]
    pl.DataFrame({"t": t, "i_alpha": i.real, "i_beta": i.imag}).write_csv(tmp_path / "i.csv")
    fine = np.arange(-500 * rate, (ROWS + 500) * rate) * H / rate + start
    at = (
        np.floor((fine - start + 1e-9) / H) * H + start
    )  # voltages are held over a sample of the first file
    other = {"t": fine + shift, "u_alpha": signals(at)[0].real, "u_beta": signals(at)[0].imag}
    if with_common_column:
        other["i_alpha"] = signals(fine)[1].real
    pl.DataFrame(other).write_csv(tmp_path / "u.csv")
    return read_log


@pytest.mark.parametrize("rate", [1, 4])
def test_joined_by_their_stamps(tmp_path, rate):
    write_two_files(tmp_path, rate=rate)
    log = read_log(tmp_path / "i.csv", join=[str(tmp_path / "u.csv")])
    _, i, u = rows_of(log, size=333)
    np.testing.assert_allclose(i[:, 0], signals(T)[1].real, atol=1e-9)
    np.testing.assert_allclose(u[1:, 0], signals(T)[0].real[:-1], atol=1e-6)


def test_a_channel_that_both_files_have_is_the_first_one_s(tmp_path):
    u, i = signals(T)
    first = {"t": T, "i_alpha": i.real, "i_beta": i.imag, "u_alpha": u.real, "u_beta": u.imag}
    pl.DataFrame(first).write_csv(tmp_path / "a.csv")
    slow = {"t": T[::5], "i_alpha": 0 * T[::5], "theta_e": np.mod(SPEED * T[::5], 6.28)}
    pl.DataFrame(slow).write_csv(tmp_path / "b.csv")
    log = read_log(tmp_path / "a.csv", join=[str(tmp_path / "b.csv")])
    np.testing.assert_array_equal(rows_of(log)[1][:, 0], i.real)


def test_joined_files_may_have_different_units(tmp_path):
    u, i = signals(T)
    currents = {"t [ms]": 1e3 * T, "i_alpha [mA]": 1e3 * i.real, "i_beta [mA]": 1e3 * i.imag}
    pl.DataFrame(currents).write_csv(tmp_path / "i.csv")
    voltages = {"time [us]": 1e6 * T, "u_alpha [mV]": 1e3 * u.real, "u_beta [mV]": 1e3 * u.imag}
    pl.DataFrame(voltages).write_csv(tmp_path / "u.csv")
    t, current, voltage = rows_of(read_log(tmp_path / "i.csv", join=[str(tmp_path / "u.csv")]))
    np.testing.assert_allclose(t, T, atol=1e-9)
    np.testing.assert_allclose(current[:, 0], i.real, atol=1e-9)
    np.testing.assert_allclose(voltage[1:, 0], u.real[:-1], atol=1e-6)


def test_joined_row_by_row(tmp_path):
    u, i = signals(T)
    pl.DataFrame({"t": T, "i_alpha": i.real, "i_beta": i.imag}).write_csv(tmp_path / "i.csv")
    pl.DataFrame({"t": 50 + T, "u_alpha": u.real, "u_beta": u.imag}).write_csv(tmp_path / "u.csv")
    join = [str(tmp_path / "u.csv")]
    with pytest.raises(RecordError, match=r"runs from 50 s.*align='auto'"):
        read_log(tmp_path / "i.csv", join=join)
    _, _, voltage = rows_of(read_log(tmp_path / "i.csv", join=join, align="index"))
    np.testing.assert_allclose(voltage[1:, 0], u.real[:-1], atol=1e-9)


def test_a_joined_file_needs_rows(tmp_path):
    u, i = signals(T)
    first = {"t": T, "i_alpha": i.real, "i_beta": i.imag, "u_alpha": u.real, "u_beta": u.imag}
    pl.DataFrame(first).write_csv(tmp_path / "a.csv")
    pl.DataFrame({"t": T[:2], "theta_e": T[:2]}).write_csv(tmp_path / "b.csv")
    with pytest.raises(RecordError, match=r"b.csv: 2 rows; a file that is joined"):
        read_log(tmp_path / "a.csv", join=[str(tmp_path / "b.csv")])


@pytest.mark.parametrize("shift", [0.0, 0.0123, -0.00437, 13.00005])
def test_aligned_by_a_column_that_both_have(tmp_path, shift):
    write_two_files(tmp_path, shift=shift, with_common_column=True)
    log = read_log(
        tmp_path / "i.csv",
        join=[str(tmp_path / "u.csv")],
        columns={"i_alpha": "i/i_alpha"},
        align="auto",
    )
    assert any("correlation" in note and "i_alpha of both files" in note for note in log.notes)
    _, _, u = rows_of(log)
    # The voltages agree to within a hundredth of a sample.
    np.testing.assert_allclose(u[10:, 0], signals(T)[0].real[9:-1], atol=0.02 * 12 * SPEED * H)


def test_aligned_by_the_speed_of_both(tmp_path):
    write_two_files(tmp_path, shift=0.05)
    log = read_log(tmp_path / "i.csv", join=[str(tmp_path / "u.csv")], align="auto")
    (note,) = [note for note in log.notes if "turn" in note]
    ahead = float(note.split("clock is ")[1].split(" s")[0])
    assert ahead == pytest.approx(0.05, abs=3e-3)


@pytest.mark.parametrize(("shift", "noted"), [(0.0, False), (0.05, True)])
def test_different_clocks_are_noted(tmp_path, shift, noted):
    write_two_files(tmp_path, shift=shift)
    log = read_log(tmp_path / "i.csv", join=[str(tmp_path / "u.csv")])
    assert any("--align auto corrects this" in note for note in log.notes) == noted


def test_one_channel_a_file(tmp_path):
    """LeCroy writes such files: "Time,Ampl" below a preamble, and the channel as file name."""
    u, i = signals(T)
    columns = {"Ia": i.real, "Ib": (i * np.exp(-2j * np.pi / 3)).real}
    for n, name in enumerate(("Ua", "Ub", "Uc")):
        columns[name] = (u * np.exp(-2j * np.pi / 3 * n)).real
    for name, values in columns.items():
        rows = ["LECROYWS424,4000,Waveform", "Segments,1,SegmentSize,4000"]
        rows += ["Segment,TrigTime,TimeSinceSegment1", "#1,26-Mar-2026 14:34:31,0   ", "Time,Ampl"]
        rows += [f"{a:.6e},{b:.9g}" for a, b in zip(T, values, strict=True)]
        (tmp_path / f"{name}.csv").write_text("\n".join(rows))
    files = [str(tmp_path / f"{name}.csv") for name in columns]
    log = read_log(files[0], join=files[1:])
    _, current, voltage = rows_of(log)
    np.testing.assert_allclose(current[:, 0], i.real, atol=1e-7)
    np.testing.assert_allclose(voltage[1:, 1], u.imag[:-1], atol=1e-4)


def test_old_tektronix_files_with_the_preamble_beside(tmp_path):
    """A TDS2000B writes one channel per file; the preamble is to the left of the data."""
    u, i = signals(T)
    columns = {"CH1": (i.real, "A"), "CH2": ((i * np.exp(-2j * np.pi / 3)).real, "A")}
    phases = [(u * np.exp(-2j * np.pi / 3 * n)).real for n in range(3)]
    columns |= {"CH3": (phases[0] - phases[1], "V"), "CH4": (phases[1] - phases[2], "V")}
    for name, (values, unit) in columns.items():
        keys = [("Record Length", "4.0e+03"), ("Sample Interval", "1.0e-04"), ("", "")]
        keys += [("Source", name), ("Vertical Units", unit), ("Horizontal Units", "s")]
        rows = [
            f"{a},{b},,{t:.12f},  {v:.7f},"
            for (a, b), t, v in zip(keys + [("", "")] * (ROWS - len(keys)), T, values, strict=True)
        ]
        (tmp_path / f"F0000{name}.CSV").write_text("\r\n".join(rows) + "\r\n")
    files = [str(tmp_path / f"F0000{name}.CSV") for name in columns]
    log = read_log(files[0], join=files[1:])
    _, current, voltage = rows_of(log)
    assert log.frame == "line"
    np.testing.assert_allclose(current[:, 0], i.real, atol=1e-6)
    np.testing.assert_allclose(voltage[1:, 1], u.imag[:-1], atol=1e-4)


def test_samples_lost_here_and_there_with_a_sample_time_that_is_given():
    """Single lost samples look like rounded stamps: only the sample time distinguishes them."""
    present = np.random.default_rng(1).random(ROWS) > 0.03
    present[:100] = True
    log = read_log({name: values[present] for name, values in columns(T).items()}, sample_time=H)
    t, current, _ = rows_of(log)
    assert np.allclose(t, T, atol=1e-9)
    assert np.isnan(current[~present]).all()
