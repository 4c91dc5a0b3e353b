"""Formats: paths of channels, batches, and messages about broken files or missing libraries."""

import importlib
import json
import os
import sys

import numpy as np
import polars as pl
import pytest

from fluxobs import RecordError
from fluxobs.logs import read_log
from fluxobs.logs.formats import FORMATS, open_tables
from fluxobs.logs.meaning.channels import list_channels

ROWS = 30_000
T = np.arange(ROWS) * 1e-4
SIGNALS = {name: np.cos(300 * T + n) for n, name in enumerate(("i_a", "i_b", "u_a", "u_b", "u_c"))}
ENDINGS = (
    *(".parquet", ".csv", ".csv.gz", ".feather", ".json", ".jsonl", ".mf4", ".tdms", ".h5"),
    *(".npy", ".npz"),
)


def write(path):
    columns = {"t": T} | SIGNALS
    ending = "".join(path.suffixes)
    frame = pl.DataFrame(columns)
    match ending:
        case ".parquet":
            frame.write_parquet(path)
        case ".csv":
            frame.write_csv(path)
        case ".csv.gz":
            import gzip

            path.write_bytes(gzip.compress(frame.write_csv().encode()))
        case ".feather":
            frame.write_ipc(path)
        case ".json":
            path.write_text(json.dumps({name: list(values) for name, values in columns.items()}))
        case ".jsonl":
            frame.write_ndjson(path)
        case ".npz":
            np.savez(path, **columns)
        case ".npy":
            array = np.zeros(ROWS, [(name, "f8") for name in columns])
            for name, values in columns.items():
                array[name] = values
            np.save(path, array)
        case ".mf4":
            from asammdf import MDF, Signal

            mdf = MDF(version="4.10")
            mdf.append([Signal(v, T, name=n) for n, v in SIGNALS.items()], acq_name="drive")
            mdf.save(path, overwrite=True)
            mdf.close()
        case ".tdms":
            from nptdms import ChannelObject, TdmsWriter

            with TdmsWriter(path) as writer:
                properties = {"wf_increment": 1e-4, "wf_start_offset": 0.0}
                writer.write_segment(
                    [ChannelObject("drive", n, v, properties) for n, v in SIGNALS.items()]
                )
        case ".h5":
            import h5py

            with h5py.File(path, "w") as file:
                for name, values in columns.items():
                    file[name] = values
    return path


@pytest.mark.parametrize("ending", ENDINGS)
def test_batches_are_the_signals_wherever_they_are_cut(tmp_path, ending, monkeypatch):
    if ending == ".mf4":  # a small file has one block: split this block like a large block
        monkeypatch.setattr("fluxobs.logs.formats.mdf.BLOCK", 1000)
    if ".csv" in ending:
        source = importlib.import_module("fluxobs.logs.formats.text.source")
        monkeypatch.setattr(source, "BLOCK", 10_000)
        monkeypatch.setattr(source, "KEPT", 0)
    (table,) = open_tables(write(tmp_path / f"log{ending}"))
    assert table.rows == ROWS
    names = list(SIGNALS)
    for first, last, size in ((0, ROWS, 7_000), (11_111, 11_200, 13), (ROWS - 5, ROWS, 100)):
        batches = list(table.batches(names, first, last, size))
        for name in names:
            values = np.concatenate([batch[name] for batch in batches])
            np.testing.assert_allclose(values, SIGNALS[name][first:last], atol=1e-12)
    log = read_log(tmp_path / f"log{ending}")
    assert log.sample_time == pytest.approx(1e-4)


@pytest.mark.skipif(sys.platform != "linux", reason="file names are text on other systems")
@pytest.mark.parametrize("ending", ENDINGS)
def test_a_file_name_that_is_not_utf8(tmp_path, ending):
    path = tmp_path / os.fsdecode(b"caf\xe9" + ending.encode())
    write(tmp_path / f"log{ending}").rename(path)
    log = read_log(path)
    assert len(log) == ROWS
    assert log.sample_time == pytest.approx(1e-4)


@pytest.mark.parametrize("ending", sorted(FORMATS))
def test_a_broken_file_is_refused(tmp_path, ending):
    path = tmp_path / f"log{ending}"
    path.write_bytes(b"this is not what its ending says\x00\x01" * 50)
    with pytest.raises(RecordError, match=r"log\."):
        open_tables(path)


@pytest.mark.parametrize(
    ("ending", "module", "extra"),
    [
        (".mf4", "asammdf", "mdf"),
        (".tdms", "nptdms", "tdms"),
        (".ulg", "pyulog", "ulog"),
        (".h5", "h5py", "hdf5"),
        (".mat", "scipy.io", "mat"),
        (".xlsx", "fastexcel", "excel"),
    ],
)
def test_a_missing_library_is_named_with_its_extra(tmp_path, ending, module, extra, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / f"log{ending}").write_bytes(b"x")
    with pytest.raises(RecordError, match=rf'pip install "fluxobs\[{extra}\]"'):
        open_tables(tmp_path / f"log{ending}")


def test_equal_names_in_groups_differ_by_their_paths(tmp_path):
    import h5py

    with h5py.File(tmp_path / "log.h5", "w") as file:
        for group in ("left", "right"):
            for name, values in SIGNALS.items():
                file[f"{group}/{name}"] = values if group == "left" else 2 * values
        file["t"] = T
    columns = {name: f"right/{name}" for name in SIGNALS}
    log = read_log(tmp_path / "log.h5", columns=columns)
    (rows,) = log.aligned()
    np.testing.assert_allclose(rows.current[:, 0], 2 * SIGNALS["i_a"])
    listed = [channel.column for channel in list_channels(tmp_path / "log.h5").channels]
    assert "left/u_c" in listed


def test_the_end_of_a_path_suffices_where_it_is_unique(tmp_path):
    import h5py

    with h5py.File(tmp_path / "log.h5", "w") as file:
        for n, (name, values) in enumerate(SIGNALS.items()):
            file[f"run/adc{n}/{name}"] = values
        file["run/clock"] = T
    log = read_log(tmp_path / "log.h5", columns={"i_a": "adc0/i_a", "t": "clock"})
    assert log.names["i_a"] == "run/adc0/i_a"


def test_matrices_and_objects_in_an_archive(tmp_path):
    matrix = np.stack(list(SIGNALS.values())[2:], axis=1)
    np.savez(tmp_path / "log.npz", t=T, iabc=matrix, uabc=matrix.T, note=np.array([None, "x"]))
    (table,) = open_tables(tmp_path / "log.npz")
    assert {"t", "iabc[0]", "uabc[2]"} <= set(table.columns)
    (batch,) = table.batches(["uabc[1]"], 0, 9)
    np.testing.assert_array_equal(batch["uabc[1]"], SIGNALS["u_b"][:9])


def test_sheets_with_times_of_their_own(tmp_path):
    pytest.importorskip("fastexcel")
    from xlsxwriter import Workbook

    head = {name: values[:200] for name, values in ({"t": T} | SIGNALS).items()}
    with Workbook(tmp_path / "log.xlsx") as book:
        for sheet, letter in (("I", "i"), ("U", "u")):
            columns = {n: v for n, v in head.items() if n == "t" or n.startswith(letter)}
            pl.DataFrame(columns).write_excel(book, sheet)
    log = read_log(tmp_path / "log.xlsx")
    assert log.names["i_a"] == "I/i_a"
    rows = next(log.aligned())
    u_a, u_b, u_c = (SIGNALS[name][:200] for name in ("u_a", "u_b", "u_c"))
    np.testing.assert_allclose(rows.voltage[1:, 0], ((2 * u_a - u_b - u_c) / 3)[:-1], atol=1e-9)


def test_sheets_without_a_table(tmp_path):
    """Excel adds empty sheets; these sheets, and sheets with only a title, are skipped."""
    pytest.importorskip("fastexcel")
    from xlsxwriter import Workbook

    table = pl.DataFrame({name: values[:200] for name, values in ({"t": T} | SIGNALS).items()})
    path = tmp_path / "log.xlsx"
    with Workbook(path) as book:
        for row in ([], ["Test bench 3"]):
            book.add_worksheet().write_row(0, 0, row)
        table.write_excel(book, "Data")
    log = read_log(path)
    assert len(log) == 200
    for row, message in (
        ([], "log.xlsx: all sheets are empty"),
        (["a", "b"], "no columns of numbers"),
    ):
        with Workbook(path) as book:
            book.add_worksheet()
            book.add_worksheet().write_row(0, 0, row)
        with pytest.raises(RecordError, match=message):
            read_log(path)


def test_groups_that_are_named_as_phases(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["time"] = T
        for name, values in SIGNALS.items():
            file[{"i": "currents", "u": "voltages"}[name[0]] + "/" + name[-1]] = values
    log = read_log(tmp_path / "log.h5")
    assert log.names["u_c"] == "voltages/c"
    assert "i_a" not in log.layout.unit


def test_rows_in_json(tmp_path):
    rows = pl.DataFrame({"t": T[:100]} | {n: v[:100] for n, v in SIGNALS.items()})
    (tmp_path / "log.json").write_text(rows.write_json())
    (table,) = open_tables(tmp_path / "log.json")
    assert table.rows == 100
    (batch,) = table.batches(["u_b"], 0, 100)
    np.testing.assert_allclose(batch["u_b"], SIGNALS["u_b"][:100], atol=1e-12)


def test_matrices_have_numbered_columns(tmp_path):
    from scipy.io import savemat

    matrix = np.stack([T, *SIGNALS.values()], axis=1)
    savemat(tmp_path / "log.mat", {"data": matrix})
    names = ("t", *SIGNALS)
    columns = {name: f"data[{n}]" for n, name in enumerate(names)}
    log = read_log(tmp_path / "log.mat", columns=columns)
    (rows,) = log.aligned()
    assert rows.current.shape == (ROWS, 2)
    np.save(tmp_path / "log.npy", matrix)
    with pytest.raises(RecordError, match=r'give them with header "t,u_a'):
        read_log(tmp_path / "log.npy")
    assert len(read_log(tmp_path / "log.npy", header=",".join(names))) == ROWS
    with pytest.raises(RecordError, match="2 names for 6 columns"):
        read_log(tmp_path / "log.npy", header="t,i_a")


def test_a_header_for_a_file_without(tmp_path):
    pl.DataFrame({"t": T} | SIGNALS).write_csv(tmp_path / "log.txt", include_header=False)
    log = read_log(tmp_path / "log.txt", header="t,i_a,i_b,u_a,u_b,u_c")
    assert len(log) == ROWS
    with pytest.raises(RecordError, match="expected different names"):
        read_log(tmp_path / "log.txt", header="t,i_a,i_a")


@pytest.mark.parametrize(
    ("columns", "step"),
    [
        ({"i_a": range(9), "u_a": range(9)}, None),
        ({"t": [0.0, 0.5], "i_a": [1, 2]}, None),
        ({"t": [0.0, 0.5, 1.0], "i_a": [1, 2, 3]}, 0.5),
        ({"t [ms]": [0.0, 2.0, 4.0, 6.0], "i_a": [1, 2, 3, 4]}, 2e-3),
        ({"t": [3.0, 2.0, 1.0], "i_a": [1, 2, 3]}, None),
    ],
)
def test_the_sample_time_of_a_channel(tmp_path, columns, step):
    pl.DataFrame(columns).write_csv(tmp_path / "log.csv")
    for channel in list_channels(tmp_path / "log.csv").channels:
        assert channel.sample_time == (step if step is None else pytest.approx(step))
