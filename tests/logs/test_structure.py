"""Headers of text files and nested data, written by hand: names, units and sample times."""

from pathlib import Path

import numpy as np
import pytest

from fluxobs import RecordError
from fluxobs.logs.formats import timing
from fluxobs.logs.formats.formula import is_arithmetic
from fluxobs.logs.formats.nested import Contents, tables
from fluxobs.logs.formats.text import structure
from fluxobs.logs.formats.text.cells import clock_formats, is_missing, is_number, split


def structure_of(head, row="{k},1.5,-2.5", rows=40):
    lines = [*head.splitlines(), *(row.format(k=k) for k in range(rows))]
    return structure.find_structure([f"{line}\n" for line in lines], [], "log.csv", None)


@pytest.mark.parametrize(
    ("head", "names", "units"),
    [
        ("t,a,b", ("t", "a", "b"), {}),
        ("# t,a,b", ("t", "a", "b"), {}),
        ("t,a,b\ns,V,A", ("t", "a", "b"), {"t": "s", "a": "V", "b": "A"}),
        ("t,a,b\ns,V", ("t", "a", "b"), {"t": "s", "a": "V"}),
        ("t,a,b\n[s],,[A]", ("t", "a", "b"), {"t": "[s]", "b": "[A]"}),
        ("t,,b", ("t", "column 2", "b"), {}),
        ("t,a", ("t", "a", "column 3"), {}),
        ("t,a,b,Increment = 5", ("t", "a", "b"), {}),
        ("t,a,b\n\n[Data]", ("t", "a", "b"), {}),
        ("Type,3\nt,a,b\nUnit: s,Unit: V,Type: x", ("t", "a", "b"), {"t": "s", "a": "V"}),
        ("Label,,motor\nt,CH1,CH 22", ("t", "CH1", "motor"), {}),
        ("Label,first,second\nt,CH1,CH 22", ("t", "first", "second"), {}),
    ],
)
def test_names_and_units_above_the_rows(head, names, units):
    result = structure_of(head)
    assert result.names == names
    assert result.said.units == units
    assert result.first_line == len(head.splitlines())


def test_units_of_a_third_of_the_columns_are_not_a_row_of_units():
    with pytest.raises(RecordError, match="expected a header"):
        structure_of("t,a,b\ns")


@pytest.mark.parametrize(
    ("row", "names", "units"),
    [
        (",{k},1.5", ("column 1", "u", "i"), {"u": "V", "i": "A"}),
        ("{k},1.5,2.5", ("Time [ms]", "u", "i"), {"u": "V", "i": "A"}),
    ],
)
def test_names_with_a_key_in_front(row, names, units):
    """The key is above an empty cell, or above the common time column."""
    result = structure_of("TraceName,u,i\nYUnitLabel,V,A\nHOffset,0,0", row)
    assert result.names == names
    assert result.said.units == units


@pytest.mark.parametrize(
    ("line", "interval", "start"),
    [
        ("Sample Interval,1.0e-04", 1e-4, 0.0),
        ("Sample Interval (ms),0.1", 1e-4, 0.0),
        ("Increment: 100 us", 1e-4, 0.0),
        ("Sample Rate = 10 kHz", 1e-4, 0.0),
        ("Sample Rate (kHz): 10", 1e-4, 0.0),
        ("fs\t2 MS/s", 5e-7, 0.0),
        ("dt,1e-4\nSample Rate,50", 1e-4, 0.0),
        ("Sample Rate,50\ndt,1e-4", 0.02, 0.0),
        ("dt,1e-4\nStart,-0.5", 1e-4, -0.5),
        ("dt,1e-4\nt0,2 ms\nt0,5", 1e-4, 2e-3),
        ("dt,-1\ndt,2e-3", 2e-3, 0.0),
        ("Sample Rate,0", None, 0.0),
        ("length,12", None, 0.0),
    ],
)
def test_the_sample_time_of_a_preamble(line, interval, start):
    metadata = structure_of(f"{line}\nt,a,b").said
    assert metadata.sample_time == (None if interval is None else pytest.approx(interval))
    assert metadata.start == pytest.approx(start)


@pytest.mark.parametrize(
    ("unit", "rate"),
    [
        *(("", 1.0), ("Hz", 1.0), ("kHz", 1e3), ("MHz", 1e6), ("GHz", 1e9), ("Sa/s", 1.0)),
        *(("kSa/s", 1e3), ("MSa/s", 1e6), ("GSa/s", 1e9), ("S/s", 1.0), ("kS/s", 1e3)),
        *(("MS/s", 1e6), ("GS/s", 1e9), ("SPS", 1.0), ("kSPS", 1e3)),
    ],
)
def test_units_of_a_rate(unit, rate):
    assert timing.rate_from(f"2.5 {unit}", "rate") == pytest.approx(2.5 * rate)
    assert timing.rate_from("2,5", f"rate [{unit}]") == pytest.approx(2.5 * rate)
    assert timing.rate_from(f"0 {unit}", "rate") is None
    assert timing.rate_from(f"-1 {unit}", "rate") is None


@pytest.mark.parametrize("text", ["x", "1 apples", ""])
def test_malformed_times(text):
    assert timing.rate_from(text, "rate") is None
    assert timing.seconds_from(text, "dt") is None
    assert timing.interval_from(text, "dt") is None


def test_values_of_time():
    assert timing.seconds_from("-2.5e-3", "dt") == -2.5e-3
    assert timing.seconds_from("3 MS", "dt") == pytest.approx(3e-3)
    assert timing.seconds_from("4", "dt (us)") == pytest.approx(4e-6)
    assert timing.interval_from("0", "dt") is None
    assert timing.interval_from("-1", "dt") is None
    assert timing.seconds_from("1.2.3", "dt") == 0.0


def test_a_row_of_too_many_columns():
    limit = structure.MOST_COLUMNS
    row = "{k}," + ",".join(["1"] * (limit - 1))
    names = ",".join(f"c{n}" for n in range(limit))
    assert len(structure_of(names, row, rows=2).names) == limit
    with pytest.raises(RecordError, match=f"a row has {limit + 1} cells, more than {limit}"):
        structure_of(names, row + ",1", rows=2)


@pytest.mark.parametrize(
    ("kinds", "row"),
    [("nn", True), ("nt", True), ("ntt", False), ("ct", False), ("cn", True), ("ee", False)],
)
def test_half_of_the_cells_of_a_row_are_numbers(kinds, row):
    assert structure._is_row(kinds) == row


@pytest.mark.parametrize(
    ("kinds", "usual", "alike"),
    [
        *(("nnn", "nnn", True), ("nen", "nnn", True), ("ntn", "nnn", False), ("nn", "nnn", False)),
        *(("nnt", "nne", True), ("tnn", "enn", False), ("nnn", "enn", True), ("tnn", "tnn", True)),
    ],
)
def test_rows_that_are_alike(kinds, usual, alike):
    assert structure.is_alike(kinds, usual) == alike


@pytest.mark.parametrize(
    ("kinds", "usual", "mistake"),
    [("nnt", "nnn", True), ("ntt", "nnn", False), ("nt", "nn", False), ("tnn", "nnn", False)],
)
def test_a_row_with_a_mistake(kinds, usual, mistake):
    """More than half of the row's cells are numbers, and the first cell is of the usual kind."""
    assert structure._with_a_mistake(kinds, usual) == mistake


def test_delimiters_with_more_cells_win():
    assert structure.row_kind(["1;2;3\n"] * 10, []) == (";", "nnn")
    assert structure.row_kind(["1\t2\n"] * 10, []) == ("\t", "nn")
    assert structure.row_kind(["7\n"] * 10, [])[1] == "n"
    assert structure.row_kind(["a,b\n"], []) == (",", "ee")


def test_kinds_of_cells():
    for cell in ("1", "-1.5", "+.5", "2.", "1e-3", "\u22121,5", "1,5E+3"):
        assert is_number(cell), cell
    for cell in ("", "1.2.3", "e5", "1 2", ".", "0x1"):
        assert not is_number(cell), cell
    assert all(map(is_missing, ("", " NaN ", "--", "#N/A", "inf")))
    assert not is_missing("0")
    assert clock_formats("2024-05-06T07:08:09.5") == ("%Y-%m-%dT%H:%M:%S%.f",)
    assert len(clock_formats("5/6/2024 07:08:09")) == 2
    assert clock_formats("07:08") == ()
    assert split('"a, b", c\n', ",") == ["a, b", "c"]
    assert split("a   b\n", " ") == ["a", "b"]


# ---- nested ---------------------------------------------------------------------------------


def test_columns_of_nested_data():
    contents = Contents()
    matrix = np.arange(30.0).reshape(10, 3)
    for name, data in {
        "line": np.arange(10.0),
        "row": np.arange(10.0)[None],
        "tall": matrix,
        "wide": matrix.T,
        "short": np.arange(7.0),
        "least": np.arange(8.0),
        "text": np.array(["x"] * 10),
        "one": np.array([[2.5]]),
        "image": np.zeros((257, 300)),
        "cube": np.zeros((10, 3, 3)),
    }.items():
        contents.add(name, data, "V" if name == "line" else None)
    names = ["line", "row", *(f"{name}[{n}]" for name in ("tall", "wide") for n in range(3))]
    assert list(contents.columns) == [*names, "least"]
    assert contents.numbers == {"one": 2.5}
    assert contents.units == {"line": "V"}
    for name in names:
        rows, read = contents.columns[name]
        n = int(name[-2]) if "[" in name else None
        expected = np.arange(10.0) if n is None else matrix[:, n]
        np.testing.assert_array_equal(np.ravel(read(2, 5)), expected[2:5])
        assert rows == 10
    contents.add("most", np.zeros((256, 300)))
    assert "most[255]" in contents.columns


@pytest.mark.parametrize(
    ("numbers", "interval", "start"),
    [
        ({"a/dt": 0.5}, 0.5, 0.0),
        ({"fs": 4.0}, 0.25, 0.0),
        ({"dt": 0.5, "fs": 4.0, "t0": 3.0}, 0.5, 3.0),
        ({"fs": 4.0, "dt": 0.5}, 0.5, 0.0),
        ({"dt": -1.0, "fs": -1.0, "tstart": -2.0}, None, -2.0),
    ],
)
def test_the_sample_time_of_nested_data(numbers, interval, start):
    contents = Contents({"x": (10, lambda first, last: np.zeros(last - first))}, {}, numbers)
    (table,) = tables(Path("log"), contents)
    assert (table.said.sample_time, table.said.start) == (interval, start)


def test_groups_with_times_of_their_own_are_tables():
    def column(rows):
        return rows, lambda first, last: np.zeros(last - first)

    names = ["a/time", "a/x", "b/time", "b/y", "c/z"]
    contents = Contents({name: column(10) for name in names} | {"d/w": column(20)})
    assert [table.columns for table in tables(Path("log"), contents)] == [
        *(["a/time", "a/x"], ["b/time", "b/y"], ["c/z"], ["d/w"])
    ]
    contents = Contents({name: column(10) for name in ("a/time", "a/x", "c/z")})
    assert [table.columns for table in tables(Path("log"), contents)] == [["a/time", "a/x", "c/z"]]


@pytest.mark.parametrize(
    ("formula", "arithmetic"),
    [
        *(("X**16", True), ("X1**17", False), ("X**-16", False), ("X**-17", False)),
        *(("(X**2 + 1)**2", False), ("2**X", False), ("2**2", False), ("-X % 3", True)),
        *(("sin(X) + log10(abs(X1))", True), ("sin", False), ("X()", False), ("X.real", False)),
        *(("sqrt(X, out=X)", False), ("'a'", False), ("True", False), ("1 if X else 2", False)),
        *(("1+" * 499 + "X1", True), ("1+" * 499 + "X1 ", False), ("1 +", False), ("", False)),
    ],
)
def test_formulas(formula, arithmetic):
    assert is_arithmetic(formula) == arithmetic
