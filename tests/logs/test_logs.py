"""Readers, frames and alignment, tested with one record in every layout and with broken files."""

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fluxobs import Record, RecordError, SurfacePMSM
from fluxobs.logs.formats import open_tables
from fluxobs.logs.meaning.layout import Layout
from fluxobs.logs.meaning.options import LayoutOptions, ReadOptions
from fluxobs.logs.read import read_log
from fluxobs.logs.record import interval_rows
from fluxobs.machines.model.frames import wrap
from fluxobs.machines.model.inverter import InverterError

ROWS, H = 200, 1e-3
K = np.arange(ROWS)
THETA = wrap(0.3 + 0.2 * K)
U = np.stack([10 * np.cos(0.2 * K), 10 * np.sin(0.2 * K)], axis=1)
I = np.stack([np.cos(0.2 * K - 1), np.sin(0.2 * K - 1)], axis=1)  # noqa: E741
PLAIN = {
    "t": K * H,
    "u_alpha": U[:, 0],
    "u_beta": U[:, 1],
    "i_alpha": I[:, 0],
    "i_beta": I[:, 1],
    "theta_e": THETA,
}


def phases(vector, common=0.0):
    x, y = vector.T
    root = np.sqrt(3) / 2
    return x + common, -x / 2 + root * y + common, -x / 2 - root * y + common


def csv(path, columns, delimiter=",", decimal_comma=False):
    lines = [delimiter.join(columns)]
    for row in zip(*columns.values(), strict=True):
        cells = [f"{value:.12g}" for value in row]
        lines.append(
            delimiter.join(cell.replace(".", ",") if decimal_comma else cell for cell in cells)
        )
    path.write_text("\n".join(lines) + "\n")
    return path


def read(path, size=None, **layout):
    log = read_log(path, **layout)
    batches = list(log.aligned(**({} if size is None else {"size": size})))
    return log, *(
        None if batches[0][n] is None else np.concatenate([batch[n] for batch in batches])
        for n in range(4)
    )


def check(result, voltage=U, current=I, rtol=1e-9):
    _, _, i, u, _ = result
    np.testing.assert_allclose(i, current, rtol=0, atol=rtol * 10)
    np.testing.assert_allclose(u[1:], voltage[:-1], rtol=0, atol=rtol * 100)
    assert np.isnan(u[0]).all()


# ---- formats ---------------------------------------------------------------------------


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|", " "])
def test_any_delimiter(tmp_path, delimiter):
    check(read(csv(tmp_path / "log.csv", PLAIN, delimiter)))


def test_decimal_comma(tmp_path):
    check(read(csv(tmp_path / "log.txt", PLAIN, ";", decimal_comma=True)))


def test_parquet_and_npz(tmp_path):
    pl.DataFrame(PLAIN).write_parquet(tmp_path / "log.parquet")
    np.savez(tmp_path / "log.npz", note="a string", **PLAIN)
    for name in ("log.parquet", "log.npz"):
        check(read(tmp_path / name))


def test_integers_comments_and_quotes(tmp_path):
    text = '# scope export\n\n"t","u_alpha","u_beta","i_alpha","i_beta"\n'
    text += "".join(f"{k},{k},0,{k % 7},1\n" for k in range(50))
    (tmp_path / "log.csv").write_text(text)
    log, t, i, _, _ = read(tmp_path / "log.csv", scale={"t": 1e-3})
    assert log.sample_time == pytest.approx(1e-3)
    assert t[-1] == pytest.approx(0.049)
    assert i[10, 0] == 3


def test_quoted_delimiter_in_the_header(tmp_path):
    path = csv(tmp_path / "log.csv", PLAIN)
    path.write_text(path.read_text().replace("u_alpha", '"u, alpha"', 1))
    check(read(path, columns={"u_alpha": "u, alpha"}))


def test_decimal_comma_that_comes_late(tmp_path):
    columns = {name: np.concatenate([np.zeros(300), values]) for name, values in PLAIN.items()}
    columns["t"] = np.arange(500)
    path = csv(tmp_path / "log.csv", columns, ";", decimal_comma=True)
    _, _, i, _, _ = read(path, scale={"t": 1e-3})
    np.testing.assert_allclose(i[300:], I, atol=1e-9)


def test_decimal_comma_in_quotes(tmp_path):
    path = csv(tmp_path / "log.csv", PLAIN, ";", decimal_comma=True)
    head, *rows = path.read_text().splitlines()
    quoted = ['"' + row.replace(";", '","') + '"' for row in rows]
    path.write_text("\n".join([head.replace(";", ","), *quoted]) + "\n")
    check(read(path))


def test_a_comma_that_may_part_thousands_is_asked_about(tmp_path):
    rows = [f'{k * H:.4f},"1,234",2,3,4' for k in range(50)]
    (tmp_path / "log.csv").write_text("\n".join([",".join(PLAIN), *rows]))
    with pytest.raises(RecordError, match="'1,234': does the comma separate thousands"):
        read(tmp_path / "log.csv")


def test_a_typesetter_s_minus(tmp_path):
    path = csv(tmp_path / "log.csv", PLAIN)
    path.write_text(path.read_text().replace("-", "\u2212"), encoding="utf-8")
    check(read(path))


def test_a_preamble_without_end(tmp_path):
    path = csv(tmp_path / "log.csv", PLAIN)
    path.write_text("".join(f"Setting {k}: on\n" for k in range(900)) + path.read_text())
    with pytest.raises(RecordError, match="no rows of numbers are found in its first 600 lines"):
        read(path)


@pytest.mark.parametrize("last", [",,,,", "   ", " , ,,,\n\n"])
def test_a_last_line_without_values(tmp_path, last):
    path = csv(tmp_path / "log.csv", PLAIN)
    path.write_text(path.read_text() + last + "\n")
    result = read(path)
    check(result)
    assert len(result[0]) == ROWS


@pytest.mark.parametrize("between", ["", "   ", "# a note", "%"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_lines_between_the_rows_are_left_out(tmp_path, between, end):
    path = csv(tmp_path / "log.csv", PLAIN)
    lines = path.read_text().splitlines()
    lines = [*lines[:80], between, *lines[80:150], between, between, *lines[150:], ""]
    path.write_bytes((end.join(lines) + end).encode())
    result = read(path)
    check(result)
    assert len(result[0]) == ROWS
    assert result[0].table.place(120) == "line 123"


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_utf_16(tmp_path, encoding):
    path = csv(tmp_path / "log.csv", PLAIN)
    mark = "\ufeff" if encoding == "utf-16-be" else ""
    path.write_bytes((mark + path.read_text()).encode(encoding))
    result = read(path)
    check(result)
    assert len(result[0]) == ROWS


def test_seconds_since_1970(tmp_path):
    log = read_log(PLAIN | {"t": 1.795e9 + K * H})
    assert log.sample_time == H


def test_byte_order_mark_and_crlf(tmp_path):
    path = csv(tmp_path / "log.csv", PLAIN)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    check(read(path))


# ---- frames ----------------------------------------------------------------------------


def test_phase_voltages_with_common_mode_and_two_currents(tmp_path):
    u, i = phases(U, common=7.0), phases(I)
    columns = {"t": K * H, "u_a": u[0], "u_b": u[1], "u_c": u[2]}
    for pair in ((0, 1), (1, 2), (0, 2)):
        names = {f"i_{'abc'[n]}": i[n] for n in pair}
        check(read(csv(tmp_path / "log.csv", columns | names), frame="abc"))
    names = {f"i_{'abc'[n]}": i[n] for n in range(3)}
    check(read(csv(tmp_path / "log.csv", columns | names), frame="abc"))


def test_line_voltages(tmp_path):
    u, i = phases(U), phases(I)
    columns = {"t": K * H, "u_ab": u[0] - u[1], "u_bc": u[1] - u[2], "i_a": i[0], "i_b": i[1]}
    check(read(csv(tmp_path / "log.csv", columns), frame="line"))


@pytest.mark.parametrize("constant", [False, True])
def test_duty_cycles(tmp_path, constant):
    link = np.full(ROWS, 50.0) if constant else 50 + 5 * np.sin(K)
    u, i = phases(U), phases(I)
    columns = {"t": K * H} | {f"d_{n}": 0.5 + v / link for n, v in zip("abc", u, strict=True)}
    columns |= {"i_a": i[0], "i_b": i[1]}
    if constant:
        check(read(csv(tmp_path / "log.csv", columns), frame="duty", udc=50.0))
    else:
        check(read(csv(tmp_path / "log.csv", columns | {"udc": link}), frame="duty"))


@pytest.mark.parametrize("lag", [0, -1, 0.5])
def test_rotor_frame_turns_the_voltage_by_the_angle_in_mid_interval(tmp_path, lag):
    theta = wrap(0.3 + 0.2 * K)
    u_dq, i_dq = np.array([1.0, 2.0]), np.array([-0.5, 3.0])
    columns = {"t": K * H, "theta_e": theta}
    columns |= {"u_d": np.full(ROWS, u_dq[0]), "u_q": np.full(ROWS, u_dq[1])}
    columns |= {"i_d": np.full(ROWS, i_dq[0]), "i_q": np.full(ROWS, i_dq[1])}
    _, _, i, u, _ = read(csv(tmp_path / "log.csv", columns), frame="dq", lag=lag)
    z = complex(*i_dq) * np.exp(1j * (0.3 + 0.2 * K))
    np.testing.assert_allclose(i, np.stack([z.real, z.imag], 1), atol=1e-9)
    z = complex(*u_dq) * np.exp(1j * (0.3 + 0.2 * (K - 0.5)))
    inside = ~np.isnan(u[:, 0])
    assert inside.sum() >= ROWS - 2
    np.testing.assert_allclose(u[inside], np.stack([z.real, z.imag], 1)[inside], atol=1e-9)


# ---- lag -------------------------------------------------------------------------------


def by_definition(u, lag):
    voltage = np.full_like(u, np.nan)
    for k in range(len(u)):
        place = k - 1 + lag
        lower, upper = int(np.floor(place)), int(np.ceil(place))
        if lower >= 0 and upper < len(u):
            voltage[k] = (
                u[lower]
                if lower == upper
                else (upper - place) * u[lower] + (place - lower) * u[upper]
            )
    return voltage


@given(lag=st.floats(-5, 5), rows=st.integers(8, 40))
def test_lag_by_its_definition(lag, rows):
    u = np.random.default_rng(rows).standard_normal((rows, 2))
    np.testing.assert_allclose(interval_rows(u, lag, 0, rows), by_definition(u, lag), atol=1e-12)


@pytest.mark.parametrize("lag", [-30.25, -1, 0, 0.5, 1, 1.5, 2, 17.75])
@pytest.mark.parametrize("size", [1, 7, 64])
def test_batches_change_no_number(tmp_path, lag, size):
    pl.DataFrame(PLAIN).write_parquet(tmp_path / "log.parquet")
    np.savez(tmp_path / "log.npz", **PLAIN)
    for name in ("log.npz", "log.parquet"):
        whole = read(tmp_path / name, lag=lag, truth={"theta_e": "theta_e"})
        cut = read(tmp_path / name, lag=lag, size=size, truth={"theta_e": "theta_e"})
        for expected, value in zip(whole[1:], cut[1:], strict=True):
            np.testing.assert_array_equal(expected, value)
        np.testing.assert_allclose(whole[3], by_definition(U, lag), atol=1e-12)


def test_batches_change_no_number_in_the_rotor_frame(tmp_path):
    columns = {"t": K * H, "theta_e": THETA, "u_d": U[:, 0], "u_q": U[:, 1]}
    np.savez(tmp_path / "log.npz", **columns, i_d=I[:, 0], i_q=I[:, 1])
    whole = read(tmp_path / "log.npz", frame="dq", lag=-1.5)
    cut = read(tmp_path / "log.npz", frame="dq", lag=-1.5, size=9)
    for expected, value in zip(whole[1:4], cut[1:4], strict=True):
        np.testing.assert_array_equal(expected, value)


def test_record_from_log_is_aligned(tmp_path):
    np.savez(tmp_path / "log.npz", **PLAIN)
    log = read_log(tmp_path / "log.npz", lag=-0.5)
    record, (rows,) = log.to_record(), list(log.aligned())
    np.testing.assert_array_equal(record.interval_voltage(), rows.voltage)


def test_record_from_log_has_its_true_angle(tmp_path):
    np.savez(tmp_path / "log.npz", **PLAIN)
    with_truth = read_log(tmp_path / "log.npz", truth={"theta_e": "theta_e"}).to_record()
    np.testing.assert_allclose(with_truth.theta_e, THETA)
    assert read_log(tmp_path / "log.npz", truth={"none": "-"}).to_record().theta_e is None


# ---- scale, truth, selection -------------------------------------------------------------


def test_scale_offset_and_mechanical_truth(tmp_path):
    columns = PLAIN | {"i_alpha": I[:, 0] * 256 + 5, "angle": wrap(THETA) / 3 * 256}
    path = csv(tmp_path / "log.csv", columns)
    scale = {"i_alpha": 1 / 256, "theta_mech": 1 / 256}
    result = read(path, scale=scale, offset={"i_alpha": -5 / 256}, truth={"theta_mech": "angle"})
    check(result)
    machine = SurfacePMSM(R_s=1.0, L_s=1e-3, n_p=3)
    angle = machine.true_position("theta_mech", result[4])
    np.testing.assert_allclose(angle, THETA, atol=1e-8)


def test_selection_in_time(tmp_path):
    np.savez(tmp_path / "log.npz", **(PLAIN | {"t": 5 + K * H}))
    log, t, i, _, _ = read(tmp_path / "log.npz", start=5.05, stop=5.1)
    assert (log.first, log.last) == (50, 101)
    assert t[0] == pytest.approx(5.05)
    np.testing.assert_array_equal(i, I[50:101])
    with pytest.raises(RecordError, match=r"between start and stop.*runs from 5 s to 5.199 s"):
        read(tmp_path / "log.npz", start=7.0)


def test_missing_values_become_nan(tmp_path):
    path = csv(tmp_path / "log.csv", PLAIN)
    lines = path.read_text().splitlines()
    for number, text in ((20, ""), (21, "NaN"), (22, "n/a")):
        cells = lines[number].split(",")
        cells[3] = text
        lines[number] = ",".join(cells)
    path.write_text("\n".join(lines))
    _, _, i, _, _ = read(path)
    assert np.flatnonzero(np.isnan(i[:, 0])).tolist() == [19, 20, 21]


# ---- guessed columns --------------------------------------------------------------------------

AB, BC = (np.array([[1.5, -np.sqrt(3) / 2], [0, np.sqrt(3)]]) @ U.T)[:2]
T = {"t": K * H}


def named(prefix, values):
    return dict(zip((f"{prefix}{n}" for n in range(3)), values, strict=True))


def test_columns_that_are_counted_from_zero():
    check(read(T | named("u", phases(U)) | named("i", phases(I))))
    bracketed = {f"vabc[{n}]": v for n, v in enumerate(phases(U))}
    check(read(T | bracketed | {f"iabc[{n}]": v for n, v in enumerate(phases(I))}))


def test_measured_currents_go_before_setpoints():
    a, b, c = phases(I)
    wanted = {"ia_ref": a + 1, "ib_cmd": b - 1, "i_c*": c}
    columns = T | dict(zip(("ua", "ub", "uc"), phases(U), strict=True)) | wanted
    check(read(columns | {"ia": a, "ib": b, "ic_meas": c}))
    log = read_log({n: v for n, v in columns.items() if n != "i_c*"})
    assert any("ia_ref is a setpoint by its name" in note for note in log.notes)


@pytest.mark.parametrize("missing", ["ua", "ub", "uc"])
def test_two_voltages_to_neutral(missing):
    voltages = dict(zip(("ua", "ub", "uc"), phases(U), strict=True))
    del voltages[missing]
    result = read(T | voltages | dict(zip(("ia", "ib"), phases(I)[:2], strict=True)))
    check(result)
    assert any(f"u_{missing[1]} is taken as -(" in note for note in result[0].notes)


@pytest.mark.parametrize(
    "voltages",
    [
        {"uab": AB, "ubc": BC},
        {"uab": AB, "uca": -AB - BC},
        {"ubc": BC, "uca": -AB - BC},
        {"uab": AB, "ubc": BC, "uca": -AB - BC},
    ],
)
def test_two_line_voltages_of_three(voltages):
    check(read(T | voltages | dict(zip(("ia", "ib"), phases(I)[:2], strict=True))))


def test_duties_of_either_sign():
    size = 1.2 * np.abs(phases(U)).max()
    duties = {f"duty_{p}": v / size for p, v in zip("abc", phases(U), strict=True)}
    columns = T | duties | {"vdc": np.full(ROWS, 2 * size)}
    result = read(columns | dict(zip(("ia", "ib"), phases(I)[:2], strict=True)))
    check(result)
    assert sum("suggests -1..1" in note for note in result[0].notes) == 1


def test_a_nameless_index_is_time(tmp_path):
    path = csv(tmp_path / "log.csv", PLAIN)
    path.write_text(path.read_text().replace("t,", ",", 1))
    result = read(path)
    check(result)
    assert any("'column 1' rises evenly and is taken as t" in n for n in result[0].notes)


def test_all_missing_channels_are_named():
    columns = T | dict(zip(("ua", "ub", "uc"), phases(U), strict=True))
    with pytest.raises(RecordError, match=r"no column .i_a. .*; i_b is missing too"):
        read_log(columns)


def test_constant_stamps(tmp_path):
    with pytest.raises(RecordError, match="time runs backwards or stands still"):
        read_log(PLAIN | {"t": np.full(ROWS, 1.7e9)})


# ---- broken files --------------------------------------------------------------------------


def broken(tmp_path, edit):
    path = csv(tmp_path / "log.csv", PLAIN)
    path.write_text(edit(path.read_text()))
    return path


def replace_cell(line, column, text):
    def edit(whole):
        lines = whole.splitlines()
        cells = lines[line - 1].split(",")
        cells[column] = text
        lines[line - 1] = ",".join(cells)
        return "\n".join(lines)

    return edit


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda s: "", "the file is empty"),
        (lambda s: s.splitlines()[0], "0 rows of data are too few"),
        (lambda s: "\n".join(s.splitlines()[:10]), "9 rows of data are too few"),
        (
            lambda s: "\n".join(s.splitlines()[1:]),
            r"line 1: expected .* found numbers: '0,10,0,0.5403",
        ),
        (lambda s: s.replace("u_beta", "u_bata", 1), "no column 'u_beta'.*nearest: u_bata"),
        (lambda s: s.replace("u_beta", "u_alpha", 1), "line 1: the column 'u_alpha' occurs twice"),
        (replace_cell(42, 3, "off"), "line 42, column 'i_alpha': 'off' is not a number"),
        (replace_cell(199, 1, "1.2.3"), "line 199, column 'u_alpha': '1.2.3' is not a number"),
        (replace_cell(30, 3, "1,2,3"), "line 30: 8 cells, but the header has 6"),
        (
            lambda s: s.replace(s.splitlines()[34], "0.033,1,2"),
            "line 35: 3 cells, but the header has",
        ),
        (replace_cell(50, 0, "0.01"), "line 50: time runs backwards"),
        (replace_cell(60, 0, ""), "line 60: t is missing"),
        (replace_cell(70, 0, "0.0685"), "line 70: samples are not uniform: a step of 0.0015 s"),
    ],
)
def test_messages_say_what_is_wrong_and_where(tmp_path, edit, message):
    path = broken(tmp_path, edit)
    with pytest.raises(RecordError, match=message) as caught:
        read(path)
    assert "log.csv" in str(caught.value)


def test_a_quotation_mark_that_is_not_closed(tmp_path):
    lines = csv(tmp_path / "log.csv", PLAIN).read_text().splitlines()
    lines = [lines[0] + ",state", *(line + ",run" for line in lines[1:])]
    lines[60] = lines[60].replace("run", '"disk')
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(RecordError, match="line 61: a quotation mark is not closed"):
        read(tmp_path / "log.csv")


def test_no_file_and_no_parquet(tmp_path):
    with pytest.raises(RecordError, match="no such file"):
        open_tables(tmp_path / "log.csv")
    for name in ("log.parquet", "log.npz"):
        (tmp_path / name).write_text("hello")
        with pytest.raises(RecordError, match=r"not a readable"):
            open_tables(tmp_path / name)


def test_text_in_a_parquet_column(tmp_path):
    frame = pl.DataFrame(PLAIN | {"i_alpha": ["x"] * ROWS})
    frame.write_parquet(tmp_path / "log.parquet")
    with pytest.raises(RecordError, match="'i_alpha' holds String, not numbers"):
        read(tmp_path / "log.parquet")


def test_arrays_of_different_length(tmp_path):
    np.savez(tmp_path / "log.npz", **(PLAIN | {"u_beta": np.zeros(150)}))
    with pytest.raises(RecordError, match=r"u_beta have 150 rows and no times, but .* 200 rows"):
        read_log(tmp_path / "log.npz")
    with pytest.raises(RecordError, match=r"differ in length.*u_beta 3"):
        read_log(PLAIN | {"u_beta": np.zeros(3)})


def test_sample_time(tmp_path):
    path = csv(tmp_path / "log.csv", PLAIN)
    with pytest.raises(RecordError, match=r"t advances by 0.001 s a row.*sample_time is 0.002"):
        read(path, sample_time=2e-3)
    assert read(path, sample_time=1e-3 * (1 + 5e-4))[0].sample_time == 1e-3 * (1 + 5e-4)
    bare = csv(tmp_path / "bare.csv", {k: v for k, v in PLAIN.items() if k != "t"})
    with pytest.raises(RecordError, match="no sample time"):
        read(bare)
    check(read(bare, sample_time=H))


def test_rounded_time(tmp_path):
    columns = PLAIN | {"t": np.round(K * 1.3e-3, 3)}
    path = csv(tmp_path / "log.csv", columns)
    for layout in ({}, {"sample_time": 1.3e-3}):
        result = read(path, **layout)
        check(result)
        assert result[0].sample_time == pytest.approx(1.3e-3, rel=1e-6)
        assert any("rounded to 0.001 s" in note for note in result[0].notes)


@pytest.mark.parametrize("conversion", ["unit", "adc"])
def test_a_channel_has_one_conversion(conversion):
    with pytest.raises(RecordError, match=f"i_alpha has both {conversion} and scale"):
        read_log(
            PLAIN,
            **{conversion: {"i_alpha": {"unit": "mA", "adc": "12,100"}[conversion]}},
            scale={"i_alpha": 2.0},
        )


def test_a_later_conversion_replaces_that_of_a_record(tmp_path):
    record = tmp_path / "record.toml"
    record.write_text('unit = { i_alpha = "mA", i_beta = "mA" }\n')
    log = read_log(PLAIN, record=record, scale={"i_alpha": 2.0}, adc={"i_beta": "1,4,0"})
    assert log.conversions["i_alpha"] == (2.0, 0.0)
    assert log.conversions["i_beta"] == (2.0, 0.0)
    of_all = read_log(PLAIN, unit={"i": "mA"}, adc={"i_beta": "1,4,0"})
    assert of_all.conversions["i_alpha"] == (1e-3, 0.0)
    assert of_all.conversions["i_beta"] == (2.0, 0.0)


@pytest.mark.parametrize("lag", [199.5, -200, 1e9])
def test_lag_outside_the_record(tmp_path, lag):
    np.savez(tmp_path / "log.npz", **PLAIN)
    with pytest.raises(RecordError, match="lies outside the record of 200 rows"):
        read(tmp_path / "log.npz", lag=lag)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"sample_time": 0.0}, "sample_time must be positive"),
        ({"voltage": np.zeros((5, 4))}, r"voltage must have shape \(rows, 2\) in αβ.*got \(5, 4\)"),
        ({"voltage": np.zeros((5, 3))}, "same number of rows, got 5 and 9"),
        ({"voltage": np.zeros((5, 2))}, "same number of rows, got 5 and 9"),
        ({"theta_e": np.zeros(4)}, r"theta_e must have shape \(9,\), got \(4,\)"),
        ({"lag": 20}, "lies outside the record"),
    ],
)
def test_unusable_record(arguments, message):
    valid = {"sample_time": 1e-3, "voltage": np.zeros((9, 2)), "current": np.zeros((9, 2))}
    with pytest.raises(RecordError, match=message):
        Record(**(valid | arguments))


@pytest.mark.parametrize("size", [1, 7, 64, ROWS])
def test_inverter_losses_in_any_batches(size):
    """The loss depends on the currents at both ends; the first row uses its own current twice."""
    error = InverterError(0.8, 0.3)
    log = read_log(PLAIN)
    batches = list(log.less_inverter(error).aligned(size=size))
    previous = np.concatenate([I[:1], I[:-1]])
    expected = np.concatenate([batch.voltage for batch in log.aligned()]) - error.lost(previous, I)
    np.testing.assert_allclose(
        np.concatenate([batch.voltage for batch in batches]), expected, atol=1e-12
    )


@pytest.mark.parametrize("wrong", [["x"] * 30, {"a": 1}])
def test_records_without_numbers(wrong):
    with pytest.raises(RecordError, match="voltage must hold numbers"):
        Record(H, wrong, np.zeros(30, complex))


def test_the_types_of_the_options_name_every_field_of_a_layout():
    """`priors` is an argument of `estimate`; a note is only in a record file."""
    assert set(LayoutOptions.__annotations__) | {"frame", "priors", "note"} == set(
        Layout.model_fields
    )
    assert {"record", "preset", "frame"} <= set(ReadOptions.__annotations__)
