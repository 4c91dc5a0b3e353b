"""Files that hold a log in an awkward form: read, or refused with the way out."""

import bz2
import gzip
import io
import lzma
import zipfile

import numpy as np
import polars as pl
import pytest

import fluxobs
from fluxobs.errors import RecordError
from fluxobs.logs.formats import open_tables
from support.records import SMALL_LOG


@pytest.mark.parametrize("kind", [pl.List(pl.Float64), pl.Array(pl.Float64, len(SMALL_LOG["t"]))])
@pytest.mark.parametrize("ending", ["parquet", "arrow"])
def test_one_record_per_row_whose_cells_are_signals(tmp_path, kind, ending):
    path = tmp_path / f"record.{ending}"
    cells = {name: pl.Series([list(values)], dtype=kind) for name, values in SMALL_LOG.items()}
    frame = pl.DataFrame(cells | {"name": ["run 7"], "short": [[1.0, 2.0]]})
    frame.write_parquet(path) if ending == "parquet" else frame.write_ipc(path)
    log = fluxobs.read_log(path)
    assert len(log) == len(SMALL_LOG["t"])
    rows = next(iter(log.aligned()))
    np.testing.assert_array_equal(rows.current[:, 0], SMALL_LOG["i_alpha"])


def test_several_records_in_a_file_are_refused(tmp_path):
    path = tmp_path / "records.parquet"
    pl.DataFrame({name: [list(x), list(x)] for name, x in SMALL_LOG.items()}).write_parquet(path)
    with pytest.raises(RecordError, match=r"each row is a record\. Write one file per record"):
        fluxobs.read_log(path)


def test_an_object_of_matlab_7_3(tmp_path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "objects.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        variable = file.create_dataset("ts", data=np.array([[3707764736, 2, 1, 1, 1, 1]], "u4"))
        variable.attrs["MATLAB_class"] = np.bytes_("timeseries")
        variable.attrs["MATLAB_object_decode"] = np.int32(3)
        file.create_dataset("#subsystem#/MCOS", data=np.zeros((1, 40)))
    with path.open("r+b") as header:
        header.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    with pytest.raises(RecordError, match=r"ts \(timeseries\): objects of a MATLAB.*Save arr"):
        fluxobs.read_log(path)


def test_a_realtime_log_of_vesc_is_refused(tmp_path):
    path = tmp_path / "realtime.csv"
    names = ["ms_today", "input_voltage", "d_axis_current", "q_axis_current", "erpm", "duty_cycle"]
    lines = [";".join(names), *(f"{20 * k};48;0.1;10;20000;0.4" for k in range(100))]
    path.write_text("\n".join(lines))
    with pytest.raises(RecordError, match=r"polled at some ten hertz.*Use Sampled Data instead"):
        fluxobs.read_log(path)


TEXT = "t,u_a,u_b,i_a,i_b\n" + "".join(f"{n}e-4,1.0,2.0,{n},4.0\n" for n in range(20))


def zipped(data: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("log.csv", data)
    return file.getvalue()


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (gzip.compress, "compressed by gzip: unpack it, or name it .gz"),
        (bz2.compress, "compressed by bzip2: unpack it"),
        (lzma.compress, "compressed by xz: unpack it"),
        (zipped, "compressed by zip: unpack it, or name a spreadsheet .xlsx"),
        (lambda data: b"\x28\xb5\x2f\xfd" + data, "compressed by zstd: unpack it"),
        (lambda data: data.decode().encode("utf-32"), "text in UTF-32: save it as UTF-8"),
        (lambda data: data.replace(b"\n", b"\r"), "a carriage return only"),
    ],
    ids=["gzip", "bzip2", "xz", "zip", "zstd", "UTF-32", "CR"],
)
def test_files_that_only_look_like_text_are_refused_with_the_remedy(tmp_path, made, message):
    (tmp_path / "log.csv").write_bytes(made(TEXT.encode()))
    with pytest.raises(RecordError, match=message):
        open_tables(tmp_path / "log.csv")


def test_a_longer_row_below_the_names_is_named(tmp_path):
    """The row itself, not the row after it."""
    first, *others = TEXT.splitlines(keepends=True)
    (tmp_path / "log.csv").write_text(first + "0,1,2,3,4,5,6\n" + "".join(others))
    with pytest.raises(RecordError, match="line 2: it has 7 cells, the lines below have 5"):
        open_tables(tmp_path / "log.csv")
