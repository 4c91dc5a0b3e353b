"""A log is data: reading a log must not run code, even if its format can contain code."""

import os
import pickle
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fluxobs import FluxobsError
from fluxobs.logs import read_log
from fluxobs.logs.formats.formula import is_arithmetic
from support.records import SMALL_LOG as COLUMNS

T = COLUMNS["t"]
CORPUS = Path(__file__).parent / "corpus"


class Trap:
    """Object that creates a folder when it is unpickled."""

    def __init__(self, mark):
        self.mark = str(mark)

    def __reduce__(self):
        return os.mkdir, (self.mark,)


@pytest.fixture
def mark(tmp_path):
    """Check that the trap works; yield its folder; check that reading a log did not create it."""
    path = tmp_path / "sprung"
    pickle.loads(pickle.dumps(Trap(path)))
    path.rmdir()
    yield path
    assert not path.exists()


def trapped(mark):
    return np.array([Trap(mark)] * len(T), dtype=object)


def refused(path):
    with pytest.raises(FluxobsError) as error:
        read_log(path)
    assert path.name in str(error.value)


def test_an_array_of_objects(mark, tmp_path):
    np.save(tmp_path / "log.npy", trapped(mark), allow_pickle=True)
    refused(tmp_path / "log.npy")


def test_an_array_with_a_field_of_objects(mark, tmp_path):
    rows = np.zeros(len(T), [*((name, float) for name in COLUMNS), ("note", object)])
    for name, values in COLUMNS.items():
        rows[name] = values
    rows["note"] = trapped(mark)
    np.save(tmp_path / "log.npy", rows, allow_pickle=True)
    refused(tmp_path / "log.npy")


@pytest.mark.parametrize("name", ["log.npy", "log.npz"])
def test_a_pickle_by_another_name(mark, tmp_path, name):
    (tmp_path / name).write_bytes(pickle.dumps(Trap(mark)))
    refused(tmp_path / name)


def test_an_archive_with_a_channel_of_objects(mark, tmp_path):
    np.savez(tmp_path / "log.npz", **COLUMNS | {"i_beta": trapped(mark)})
    refused(tmp_path / "log.npz")


def test_objects_beside_the_channels_are_left_alone(mark, tmp_path):
    np.savez(tmp_path / "log.npz", **COLUMNS, notes=trapped(mark))
    assert len(read_log(tmp_path / "log.npz")) == len(T)


def test_a_pickle_in_hdf5(mark, tmp_path):
    """PyTables and pandas store objects in this way."""
    h5py = pytest.importorskip("h5py")
    data = np.void(pickle.dumps(Trap(mark)))
    with h5py.File(tmp_path / "log.h5", "w") as file:
        for name, values in COLUMNS.items():
            file[name] = values
        file["notes"] = data
        file.attrs["notes"] = data
        file["t"].attrs["units"] = data
    assert len(read_log(tmp_path / "log.h5")) == len(T)


def test_a_pickle_in_a_matlab_file(mark, tmp_path):
    io = pytest.importorskip("scipy.io")
    data = np.frombuffer(pickle.dumps(Trap(mark)), np.uint8)
    io.savemat(tmp_path / "log.mat", COLUMNS | {"notes": data})
    assert len(read_log(tmp_path / "log.mat")) == len(T)


@pytest.mark.parametrize("version", ["3.30", "4.10"])
def test_code_as_the_formula_of_an_mdf_channel(mark, tmp_path, version):
    """asammdf tries numexpr, which refuses code, and then sympy, which runs code."""
    asammdf = pytest.importorskip("asammdf")
    formula = f"__import__('os').mkdir('{mark}')"
    eval(formula)
    mark.rmdir()
    with asammdf.MDF(version=version) as file:
        file.append(
            [
                asammdf.Signal(values, T, name=name, conversion={"formula": formula})
                for name, values in COLUMNS.items()
                if name != "t"
            ]
        )
        path = file.save(tmp_path / "log.mdf")
    with pytest.raises(FluxobsError, match="by the formula") as error:
        list(read_log(path).aligned())
    assert path.name in str(error.value)


@pytest.mark.parametrize("version", ["3.30", "4.10"])
@pytest.mark.parametrize("hidden", [False, True])
def test_code_as_the_formula_of_the_time(mark, tmp_path, version, hidden):
    """asammdf converts the time of a channel group even if the time is not requested."""
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF(version=version) as file:
        file.append([asammdf.Signal(v, T, name=k) for k, v in COLUMNS.items()])
        (time,) = (channel for channel in file.groups[0].channels if channel.name == "time")
        code = f"X1+0*(\"'\"!=(lambda:__import__('os').mkdir('{mark}'))()!=\"'\")"
        if version.startswith("4"):
            from asammdf.blocks.v4_blocks import ChannelConversion

            time.conversion = ChannelConversion(conversion_type=3, formula=code)
            time.data_type = 10 if hidden else time.data_type  # a channel of bytes is not a column
        else:
            from asammdf.blocks.v2_v3_blocks import ChannelConversion

            time.conversion = ChannelConversion(conversion_type=10, formula=code.encode())
        path = file.save(tmp_path / "log.mdf")
    with pytest.raises(FluxobsError, match="by the formula") as error:
        list(read_log(path).aligned())
    assert path.name in str(error.value)


def test_code_as_the_formula_of_an_axis():
    mdf = pytest.importorskip("fluxobs.logs.formats.mdf")
    code = SimpleNamespace(formula="exit()", referenced_blocks=None)
    array = SimpleNamespace(dims_nr=2, axis_conversion_0=None, axis_conversion_1=code)
    group = SimpleNamespace(
        channels=[SimpleNamespace(name="map", conversion=None)], channel_dependencies=[[array]]
    )
    with pytest.raises(FluxobsError, match="map, axis 1"):
        mdf._check_formulas("log.mf4", SimpleNamespace(groups=[group]))


def test_a_formula_in_a_sheet(mark, tmp_path):
    """Only the values of a sheet are read, not the formulas."""
    pytest.importorskip("fastexcel")
    xlsxwriter = pytest.importorskip("xlsxwriter")
    with xlsxwriter.Workbook(tmp_path / "log.xlsx") as book:
        sheet = book.add_worksheet()
        for n, (name, values) in enumerate(COLUMNS.items()):
            sheet.write(0, n, name)
            for k, value in enumerate(values):
                sheet.write_formula(k + 1, n, f'=cmd|"/c mkdir {mark}"!A1', None, value)
    assert len(read_log(tmp_path / "log.xlsx")) == len(T)


def test_modules_beside_a_workbook(mark, tmp_path, monkeypatch):
    """The process that reads a workbook imports nothing from the workbook's folder."""
    pytest.importorskip("fastexcel")
    for name in ("fluxobs", "json", "polars", "fastexcel"):
        (tmp_path / f"{name}.py").write_text(f"import os\nos.mkdir({str(mark)!r})\n")
    monkeypatch.chdir(tmp_path)
    assert len(read_log(CORPUS / "workbook.xlsx"))


@pytest.mark.parametrize(
    "formula",
    [
        "__import__('os')",
        "X1.__class__",
        "[X1 for X1 in X1]",
        "(lambda: X1)()",
        "exec(X1)",
        "X",
        "exit()",
        "sin",
        "sin(X1, out=X1)",
        "X1()",
        "9**9**9",
        "X1**9**9",
        "(X1**2)**2",
        "(1 + sin(X1**2))**2",
        "X1**17",
        "X1**-17.0",
        "X1**1e9",
        "9**9**9**9*X1",
        "(" * 50 + "X1" + "**2)" * 50,
        "+".join(["X1"] * 1000),
        "'a' * X1",
        "f'{X1}'",
        "X1 if X1 else X1",
        "X1; X1",
        "True",
        "(" * 5000,
        "-" * 100_000 + "X1",
        "",
    ],
)
def test_a_formula_is_arithmetic(formula):
    assert is_arithmetic(formula) == (formula == "X")


@pytest.mark.parametrize("formula", ["2*X1 + 1", " -X1/3.5e-2", "sqrt(X**2 + 1) % 7", "abs(X1)"])
def test_arithmetic_is_a_formula(formula):
    assert is_arithmetic(formula)


@pytest.mark.parametrize("version", ["3.30", "4.10"])
def test_a_formula_of_an_mdf_channel_is_computed(tmp_path, version):
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF(version=version) as file:
        file.append(
            [
                asammdf.Signal(values, T, name=name, conversion={"formula": "2*X + 1"})
                for name, values in COLUMNS.items()
                if name != "t"
            ]
        )
        path = file.save(tmp_path / "log.mdf")
    (rows,) = read_log(path).aligned()
    np.testing.assert_allclose(rows.current[:, 0], 2 * np.cos(T) + 1)


def test_formulas_are_found_wherever_a_conversion_refers_to_them():
    """Conversions of asammdf refer to other conversions, or to texts."""
    mdf = pytest.importorskip("fluxobs.logs.formats.mdf")
    inner = SimpleNamespace(formula=b"exit()", referenced_blocks=None)
    outer = SimpleNamespace(formula="", referenced_blocks={"text_0": b"on", "text_1": inner})
    inner.referenced_blocks = {"default_addr": outer}
    assert list(mdf._formulas(outer)) == ["exit()"]
    leaf_block = SimpleNamespace(formula="2*X", referenced_blocks=None)
    branching = SimpleNamespace(
        formula="", referenced_blocks={"0": leaf_block, "1": outer, "2": outer}
    )
    assert sorted(mdf._formulas(branching)) == ["2*X", "exit()"]  # also after a known one
    assert list(mdf._formulas(None)) == []
